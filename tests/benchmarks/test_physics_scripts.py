"""What the benchmarks of the physics compare is the same on both sides."""

from __future__ import annotations

import numpy as np
import pytest
import same_physics
import stepping

from rlco.physics.spec.domain import SIM, STAND_IN
from rlco.physics.spec.names import TASK_NAMES


def test_all_of_rlcos_tasks_are_measured() -> None:
    assert set(TASK_NAMES) < set(stepping.TASKS)
    assert set(stepping.TASKS) == set(same_physics.TASKS)


@pytest.mark.parametrize("task", ["close_drawer", "Lift"])
def test_every_side_steps_from_the_same_starts(task: str) -> None:
    copies, begin = stepping.native(task, threads=1)
    begin()
    env, episodes = stepping.robosuite_episodes(task)
    for data, start in zip(copies.data[:3], episodes, strict=False):
        start()
        np.testing.assert_array_equal(env.sim.data._data.qpos, data.qpos)
    assert not np.array_equal(copies.data[0].qpos, copies.data[1].qpos)


def test_robosuites_tasks_have_no_domain_but_sim() -> None:
    same_physics.check_tasks(("Lift", "push_cube"), SIM)
    same_physics.check_tasks(("push_cube",), STAND_IN)
    with pytest.raises(SystemExit, match=r"domain=stand_in .* \['Lift'\]"):
        same_physics.check_tasks(("Lift", "push_cube"), STAND_IN)
