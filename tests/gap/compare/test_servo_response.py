"""A joint under its servo answers torques as MuJoCo's simulation of it does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rlco.gap.compare.arm.servo_response import JointResponse

STEP, FINE = 0.002, 1e-4
ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.002" gravity="0 0 0"
integrator="implicitfast"/><worldbody><body><joint name="turn" axis="0 0 1"
damping="0.3" armature="0.02" stiffness="4"/>
<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.002"/></body>
<body><joint name="free" axis="0 0 1"/><geom size=".1"/></body>
</worldbody><actuator><position name="turn" joint="turn" gear="2" kp="10" kv=".5"/>
</actuator></mujoco>
"""


def test_it_has_the_numbers_of_the_joint() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    found = JointResponse.of(model, "turn", model.qpos0)
    assert found is not None
    # By hand: 0.02 + 0.002 + 0.5 * 0.1^2; 0.3 + 2^2 * 0.5; 4 + 2^2 * 10.
    assert found.inertia == pytest.approx(0.027)
    assert found.damping == pytest.approx(2.3)
    assert found.stiffness == pytest.approx(44.0)


def test_a_joint_without_a_servo_has_none() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    assert JointResponse.of(model, "free", model.qpos0) is None


@pytest.mark.parametrize("frequency", [0.5, 3.0, 10.0])
def test_torques_move_it_as_in_a_simulation_of_fine_steps(frequency: float) -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.timestep = FINE
    data, times = mujoco.MjData(model), FINE * np.arange(10_000)
    torques = 0.2 * np.sin(2 * np.pi * frequency * times)
    positions = []
    for torque in torques:
        positions.append(data.qpos[0])
        data.qfrc_applied[0] = torque
        mujoco.mj_step(model, data)
    response = JointResponse.of(model, "turn", model.qpos0)
    assert response is not None
    every = round(STEP / FINE)
    found = response.positions(torques[::every], STEP)
    size = float(np.abs(positions).max())
    np.testing.assert_allclose(found, positions[::every], atol=0.01 * size)


def test_hundreds_of_torques_are_answered_each_by_itself() -> None:
    response = JointResponse(inertia=0.1, damping=4.0, stiffness=50.0)
    torques = np.random.default_rng(0).normal(size=(3, 2, 400))
    together = response.positions(torques, STEP)
    alone = response.positions(torques[2, 1], STEP)
    np.testing.assert_allclose(together[2, 1], alone, atol=1e-15)
