"""Each unseen variation changes what its name says, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest
from expert_cases import solved

from rlco.envs import make_env
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.domain import SIM, STAND_IN
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.spec.task import InitialState, Task
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.variations import VARIATIONS, domain_in

TASKS = pytest.mark.parametrize("task", [*map(make_task, TASK_NAMES)], ids=TASK_NAMES)
DISTRACTORS = 2


def scene(task: Task, variation: str | None, *, without: tuple[str, ...] = ()) -> str:
    """Return the objects' MJCF, without some attributes of their geoms and sites."""
    texts = []
    for item in task.make_objects(SIM, variation):
        root = item.get_obj()
        for element in [*root.iter("geom"), *root.iter("site")]:
            for name in without:
                element.attrib.pop(name, None)
        texts.append(ElementTree.tostring(item.get_obj(), encoding="unicode"))
    return "\n".join(texts)


def start(task: Task, variation: str | None, seed: int = 0) -> InitialState:
    return task.sample(np.random.default_rng([7, seed]), variation)


def assert_same_start(one: InitialState, other: InitialState) -> None:
    for name, value in vars(one).items():
        np.testing.assert_array_equal(vars(other)[name], value)


@TASKS
def test_an_unknown_variation_is_refused_with_the_allowed_ones(task: Task) -> None:
    assert task.variations == VARIATIONS
    message = "unknown variation 'colour' .did you mean 'colours'.*known: shapes, "
    with pytest.raises(UnknownNameError, match=message):
        start(task, "colour")
    with pytest.raises(UnknownNameError, match=message):
        task.make_objects(SIM, "colour")


@TASKS
def test_colours_change_colours_alone(task: Task) -> None:
    assert_same_start(start(task, None), start(task, "colours"))
    assert scene(task, None) != scene(task, "colours")
    assert scene(task, None, without=("rgba",)) == scene(
        task, "colours", without=("rgba",)
    )


@pytest.mark.slow
@TASKS
def test_shapes_change_shapes_and_no_masses(task: Task) -> None:
    before, after = start(task, None), start(task, "shapes")
    # Where things stand in the plane; a lower object lies lower.
    np.testing.assert_array_equal(before.object_pose[:, :2], after.object_pose[:, :2])
    np.testing.assert_array_equal(before.goal_position, after.goal_position)
    shape = ("type", "size", "pos", "quat", "density")
    assert scene(task, None) != scene(task, "shapes")
    assert scene(task, None, without=shape) == scene(task, "shapes", without=shape)
    models = [
        NativeStepper(task, SIM, num_envs=1, variation=v).model
        for v in (None, "shapes")
    ]
    moving = models[0].body_dofnum > 0
    masses = [model.body_mass[moving] for model in models]
    np.testing.assert_allclose(*masses, rtol=1e-6)


def features(task: Task, variation: str | None, count: int) -> np.ndarray:
    """Return what is random about many starts, one row each."""
    rows = []
    for seed in range(count):
        s = start(task, variation, seed)
        goals = [s.goal_position[:, :2].ravel(), s.goal_orientation()[:, 3]]
        rows.append(np.concatenate([s.object_pose[:, :2].ravel(), *goals]))
    return np.array(rows)


@TASKS
def test_initial_states_lie_outside_the_range_of_training(task: Task) -> None:
    assert scene(task, None) == scene(task, "initial_states")
    seen, unseen = (features(task, v, 300) for v in (None, "initial_states"))
    low, high = seen.min(axis=0), seen.max(axis=0)
    outside = (unseen < low) | (unseen > high)
    assert outside.any(axis=1).all()
    # The arm starts within 0.05 rad of its home instead of 0.02.
    for variation, noise in ((None, 0.02), ("initial_states", 0.05)):
        joints = [start(task, variation, i).joint_position for i in range(300)]
        assert np.std(joints, axis=0).mean() == pytest.approx(noise, rel=0.1)


@TASKS
def test_distractors_are_added_behind_everything_else(task: Task) -> None:
    before, after = start(task, None), start(task, "distractors")
    count = len(task.objects)
    assert len(after.object_pose) == count + DISTRACTORS
    np.testing.assert_array_equal(before.object_pose, after.object_pose[:count])
    np.testing.assert_array_equal(before.joint_position, after.joint_position)
    np.testing.assert_array_equal(before.goal_position, after.goal_position)
    assert scene(task, "distractors").startswith(scene(task, None))


def test_no_policy_is_told_of_distractors() -> None:
    seen = [
        make_env("pick_and_place", num_envs=2, variation=variation, seed=3).reset()
        for variation in (None, "distractors")
    ]
    both = [td["observation", "environment_state"] for td in seen]
    assert (both[0] == both[1]).all()


@pytest.mark.parametrize("backend", [NativeStepper, RobosuiteStepper])
def test_distractors_stand_where_they_were_placed(
    backend: type[NativeStepper] | type[RobosuiteStepper],
) -> None:
    task = make_task("open_drawer")
    stepper = backend(task, SIM, num_envs=1, variation="distractors")
    placed = start(task, "distractors")
    stepper.reset([placed])
    for name, pose in zip(("tin", "box"), placed.object_pose, strict=True):
        body = stepper.data[0].body(f"{name}_main")
        np.testing.assert_allclose(body.xpos, pose[:3], atol=1e-12)
    stepper.step(np.zeros((1, 10, 7)))
    # They rest: neither falling nor inside something.
    for name, pose in zip(("tin", "box"), placed.object_pose, strict=True):
        body = stepper.data[0].body(f"{name}_main")
        np.testing.assert_allclose(body.xpos, pose[:3], atol=1e-3)


@TASKS
def test_a_moved_camera_changes_what_is_reported_alone(task: Task) -> None:
    assert_same_start(start(task, None), start(task, "camera"))
    assert scene(task, None) == scene(task, "camera")
    for domain in (SIM, STAND_IN):
        moved = domain_in(domain, "camera")
        assert replace(moved, sensors=domain.sensors) == domain
        before, after = domain.sensors, moved.sensors
        changed = {k for k, v in vars(before).items() if vars(after)[k] != v}
        assert changed == {"camera_yaw", "camera_shift"}
        assert after.camera_yaw == pytest.approx(before.camera_yaw + 0.10)
        shift = np.subtract(after.camera_shift, before.camera_shift)
        np.testing.assert_allclose(shift, [0.02, -0.02])


def test_an_environment_with_a_moved_camera_reports_turned_positions() -> None:
    quiet = [
        make_env("open_drawer", variation=v, seed=3).reset()["observation"]
        for v in (None, "camera")
    ]
    assert (quiet[0]["state"] == quiet[1]["state"]).all()
    # Handle minus cabinet: turned by 0.10 rad, whatever the shift. Positions carry
    # noise of 1 mm, the same in both, which turns with nothing.
    lines = [row["environment_state"][0].numpy() for row in quiet]
    (a, b) = (line[:2] - line[2:] for line in lines)
    turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
    assert turn == pytest.approx(0.10, abs=5e-3)


@TASKS
def test_lights_change_images_alone(task: Task) -> None:
    assert_same_start(start(task, None), start(task, "lights"))
    assert scene(task, None) == scene(task, "lights")
    for domain in (SIM, STAND_IN):
        lit = domain_in(domain, "lights")
        assert replace(lit, look=domain.look) == domain
        kept = {"lights": domain.look.lights, "headlight": domain.look.headlight}
        assert replace(lit.look, **kept) == domain.look


def test_a_warm_lamp_makes_images_warmer_and_moves_nothing() -> None:
    make = partial(make_env, image_size=(64, 64), renderer="raster", seed=3)
    rows = [make("push_cube", variation=v).reset() for v in (None, "lights")]
    usual, lit = (row["observation"] for row in rows)
    for key in ("state", "environment_state"):
        assert (usual[key] == lit[key]).all()
    before, after = (row["image"].double().mean(dim=(0, 2, 3)) for row in (usual, lit))
    # Of red and blue light: a lamp that has half as much blue as red.
    assert after[2] / after[0] < 0.8 * before[2] / before[0]


def test_lights_are_refused_with_a_random_look_and_without_images() -> None:
    make = partial(make_env, "push_cube", variation="lights")
    with pytest.raises(RlcoError, match="lights sets the lights, but look=random"):
        make(look="random", image_size=(64, 64))
    with pytest.raises(RlcoError, match="changes images alone, but none are drawn"):
        make()


@pytest.mark.thorough
@TASKS
@pytest.mark.parametrize("variation", ["shapes", "initial_states"])
def test_the_expert_solves_what_changes_the_physics(task: Task, variation: str) -> None:
    assert solved(task, SIM, 10, variation=variation).mean() >= 0.9
