"""Objects that were seen inside the robot."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.demos.replay.overlap import separate

_ALL = np.ones((1, 3), dtype=bool)


def _scene(*fingers: float) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    tips = "".join(f"<geom size='.02' pos='{x} 0 0'/>" for x in fingers)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{tips}<body><freejoint/>"
        "<geom type='box' size='.03 .03 .03' mass='.1'/></body></worldbody></mujoco>"
    )
    robot = np.arange(model.ngeom) < len(fingers)
    return model, mujoco.MjData(model), robot


def test_an_object_is_moved_to_where_it_touches_and_no_farther() -> None:
    model, data, robot = _scene(-0.048)  # two millimetres inside
    separate(model, data, [0], robot, _ALL)
    np.testing.assert_allclose(data.qpos[:3], [0.002 - 2e-4, 0, 0], atol=1e-5)


def test_an_object_that_touches_nothing_stays() -> None:
    model, data, robot = _scene(-0.051)
    separate(model, data, [0], robot, _ALL)
    np.testing.assert_array_equal(data.qpos[:3], 0.0)


def test_an_object_between_two_fingers_is_held() -> None:
    model, data, robot = _scene(-0.048, 0.049)
    separate(model, data, [0], robot, _ALL)
    np.testing.assert_array_equal(data.qpos[:3], 0.0)


def test_what_is_not_told_does_not_move() -> None:
    model, data, robot = _scene(-0.048)
    separate(model, data, [0], robot, np.array([[False, True, True]]))
    assert data.qpos[0] == 0.0
