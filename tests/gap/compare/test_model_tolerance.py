"""What may be a little off in a model: which numbers, and what a part of one does."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.compare.model_tolerance import apply_tolerance, tolerance_names

_ARM = """
<mujoco><worldbody><body name="arm"><joint name="shoulder" damping="0.5"/>
<geom size="0.1" mass="2"/><body name="hand"><joint name="wrist" frictionloss="0.3"/>
<geom size="0.05" mass="1"/></body></body></worldbody><actuator>
<position name="motor" joint="shoulder" kp="40" kv="2" forcerange="-8 8"/>
<position name="small" joint="wrist" kp="10"/></actuator></mujoco>
"""


def test_the_numbers_of_an_actuator_bear_its_joints_name_and_scale_it() -> None:
    spec = mujoco.MjSpec.from_string(_ARM)
    names = tolerance_names(spec.compile())
    bodies = ("mass:arm", "inertia:arm", "mass:hand", "inertia:hand")
    joints = ("damping:shoulder", "friction:wrist")
    drives = ("gain:shoulder", "feedback:shoulder", "limit:shoulder", "gain:wrist")
    assert names == (*bodies, *joints, *drives)
    parts = {"damping:shoulder": 0.1, "gain:shoulder": 0.2, "feedback:shoulder": 0.5}
    parts |= {"limit:shoulder": -0.25, "friction:wrist": 0.5}
    apply_tolerance(spec, names, tuple(parts.get(name, 0.0) for name in names))
    model = spec.compile()
    np.testing.assert_allclose(model.dof_damping, [0.55, 0.0])
    np.testing.assert_allclose(model.dof_frictionloss, [0.0, 0.45])
    np.testing.assert_allclose(model.actuator_gainprm[1, 0], 10.0)
    np.testing.assert_allclose(model.actuator_gainprm[0, 0], 48.0)
    np.testing.assert_allclose(model.actuator_biasprm[0, :3], [0.0, -48.0, -3.0])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-6.0, 6.0])
