"""What a task's author may get wrong is told before a scene is built, all at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rlco.envs import make_env
from rlco.errors import ConfigError, RlcoError
from rlco.physics.robosuite.check_objects import check_objects
from rlco.physics.spec.domain import SIM
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.tasks.check_task import check_task
from rlco.physics.tasks.demonstrate import demonstrate
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.push_cube import TASK


def start(**changes: Any) -> Callable[..., Any]:
    """Return a `sample` that draws push_cube's starts with something changed."""

    def sample(rng: np.random.Generator, variation: str | None = None) -> Any:
        drawn = TASK.sample(rng, variation)
        return replace(drawn, **{k: change(drawn) for k, change in changes.items()})

    return sample


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_tasks_that_ship_pass(name: str) -> None:
    task = make_task(name)
    assert check_task(task) is task
    for variation in (None, *task.variations):
        check_objects(task, task.make_objects(SIM, variation), variation)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"success": lambda s: TASK.success(s)[..., None]},
            r"success returns an array of shape \(3, 1\) for 3 states, not \(3,\)",
        ),
        (
            {"success": lambda s: TASK.success(s).astype(float)},
            "success returns float64, not truth values",
        ),
        (
            {"shaped_reward": lambda before, after: 0.05},
            r"shaped_reward returns an array of shape \(\) for 3 states, not \(3,\)",
        ),
        (
            {"expert": lambda s: TASK.expert(s)[..., :3]},
            r"expert returns .* \(3, 3\) .* not \(3, 7\): one action.*gripper",
        ),
        (
            {"environment_state": lambda objects, goals: objects},
            r"environment_state returns .* \(3, 3, 3\) .* not \(3, 12\)",
        ),
        (
            {"sample": start(object_pose=lambda s: s.object_pose[:2])},
            r"object_pose of shape \(2, 7\), not \(3, 7\): position and quaternion",
        ),
        (
            {"sample": start(joint_position=lambda s: s.joint_position * np.nan)},
            "joint_position that is NaN",
        ),
        (
            {"sample": start(instruction_id=lambda s: 3)},
            "instruction_id=3, but there are 3 instructions, counted from 0",
        ),
        (
            {
                "sample": lambda rng, variation: (
                    TASK.sample(rng, variation).goal_position
                )
            },
            "sample returns ndarray, not an InitialState",
        ),
        (
            {
                "sample": start(
                    joint_position=lambda s: s.joint_position + np.random.rand()  # noqa: NPY002
                )
            },
            "another start when it is called again with the same seed",
        ),
        (
            {"fixture_joints": ("slide",)},
            r"no joint_opening, of shape \(1,\)",
        ),
        ({"training_horizon": 0}, "training_horizon=0 must be at least 1"),
        (
            {"sample": start(gripper_opening=lambda s: 0.2)},
            "gripper_opening=0.2; the fingers open from 0 to 0.08 m",
        ),
        (
            {"instructions": "push it"},
            r"instructions is one text, 'push it'; give a tuple .* \('push it',\)",
        ),
        ({"instructions": ("push it",) * 3}, "instructions holds a name twice"),
    ],
)
def test_what_does_not_fit_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"task 'push_cube': .*{message}"):
        check_task(replace(TASK, **changes))


def test_every_problem_is_reported_and_before_a_scene_is_built() -> None:
    wrong = replace(
        TASK,
        environment_state_names=("x",),
        expert=lambda s: s.tool_position,
        make_objects=lambda domain, variation: pytest.fail("a scene was built"),
    )
    with pytest.raises(ConfigError) as caught:
        make_env(wrong)
    assert len(caught.value.problems) == 2
    with pytest.raises(ConfigError, match="environment_state_names has 1 name"):
        next(demonstrate(wrong, "sim", episodes=1, seed=0))


def test_objects_are_those_that_the_task_names_in_its_order() -> None:
    objects = TASK.make_objects(SIM, None)
    with pytest.raises(ConfigError, match="make_objects returns blue_mark, green_mark"):
        check_objects(TASK, objects[::-1])
    with pytest.raises(ConfigError, match="must return objects and then goals, red_c"):
        check_objects(TASK, objects[:-1])


def test_every_object_that_moves_has_a_pose_at_the_start() -> None:
    def forgets(rng: np.random.Generator, variation: str | None = None) -> Any:
        return TASK.sample(rng, None)

    wrong = replace(TASK, sample=forgets)
    check_objects(wrong, TASK.make_objects(SIM, None))
    objects = TASK.make_objects(SIM, "distractors")
    with pytest.raises(ConfigError) as caught:
        check_objects(wrong, objects, "distractors")
    (problem,) = caught.value.problems
    assert "sample with variation='distractors' gives 3 rows" in problem
    assert "5 objects that move: red_cube, green_cube, blue_cube, tin, box" in problem


def test_an_instruction_that_no_start_has_is_not_waited_for() -> None:
    one = replace(
        TASK,
        instructions=("push the red cube onto its mark", "put it in"),
        sample=start(instruction_id=lambda s: 0),
        horizon=2,
        success=lambda state: np.ones(state.tool_position.shape[:-1], dtype=bool),
    )
    with pytest.raises(RlcoError, match=r"none of 40 .* instruction 1, 'put it in'"):
        list(demonstrate(one, "sim", episodes=4, seed=0))


def test_goals_stay_where_they_are_and_objects_can_be_moved() -> None:
    objects = TASK.make_objects(SIM, None)
    swapped = replace(TASK, objects=("red_mark",), goals=("red_cube",))
    with pytest.raises(ConfigError) as caught:
        check_objects(swapped, [objects[3], objects[0]])
    first, second = caught.value.problems
    assert "'red_mark' needs a free joint" in first
    assert "'red_cube' is one of goals, which nothing moves, but its body has" in second
