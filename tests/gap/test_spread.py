"""What may be a little off in a model: which numbers, and what a part of one does."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.spread import apply_spread, spread_names

_ARM = """
<mujoco><worldbody><body name="arm"><joint name="shoulder" damping="0.5"/>
<geom size="0.1" mass="2"/></body></worldbody><actuator>
<position name="motor" joint="shoulder" kp="40" kv="2" forcerange="-8 8"/>
</actuator></mujoco>
"""


def test_the_numbers_of_an_actuator_bear_its_joints_name_and_scale_it() -> None:
    spec = mujoco.MjSpec.from_string(_ARM)
    names = spread_names(spec.compile())
    kinds = ("mass:arm", "inertia:arm", "damping:shoulder")
    drive = ("gain:shoulder", "feedback:shoulder", "limit:shoulder")
    assert names == (*kinds, *drive)
    apply_spread(spec, names, (0.0, 0.0, 0.1, 0.2, 0.5, -0.25))
    model = spec.compile()
    np.testing.assert_allclose(model.dof_damping, 0.55)
    np.testing.assert_allclose(model.actuator_gainprm[0, 0], 48.0)
    np.testing.assert_allclose(model.actuator_biasprm[0, :3], [0.0, -48.0, -3.0])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-6.0, 6.0])
