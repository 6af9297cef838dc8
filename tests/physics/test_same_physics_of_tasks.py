"""Drawers, bowls and distractors move natively as robosuite moves them."""

from __future__ import annotations

import numpy as np
import pytest
from stepping_cases import anchor, deviation, make_pair

from rlco.physics.domain import STAND_IN
from rlco.physics.task import make_task

STEPS = 70


@pytest.mark.parametrize(
    ("name", "variation"),
    [("pick_and_place", "distractors"), ("open_drawer", None), ("close_drawer", None)],
)
def test_every_step_of_the_expert_is_repeated_exactly(
    name: str, variation: str | None
) -> None:
    task = make_task(name)
    env, stepper = make_pair(STAND_IN, exact=True, task=task, variation=variation)
    start = task.sample(np.random.default_rng([6, 0]), variation)
    env.start(start)
    stepper.reset([start])
    assert deviation(env, stepper) == 0.0
    rng = np.random.default_rng(6)
    apart, touched = [], []
    first = env.scene_state()
    for _ in range(STEPS):
        before = env.scene_state()
        noise = np.zeros(7)
        noise[:6] = 0.2 * rng.standard_normal(6)
        action = np.clip(task.expert(before) + noise, -1.0, 1.0)
        anchor(env, stepper)
        env.step(action)
        native = stepper.step(action[None, None]).at((0, 1))
        after = env.scene_state()
        apart.append(deviation(env, stepper))
        touched.append(env.touched_others)
        # All that rules read, the drawer's pose and opening among it.
        for field, value in vars(after).items():
            np.testing.assert_allclose(vars(native)[field], value, atol=1e-5)
        assert task.success(native) == task.success(after)
        for kind in ("shaped", "sparse"):
            rewards = (task.reward(before, s, kind) for s in (native, after))
            assert abs(np.diff(list(rewards)).item()) < 1e-4
    # The episode has both kinds of step, and in it something has moved.
    assert 0 < sum(touched) < STEPS
    moved = np.abs(env.scene_state().object_position - first.object_position)
    assert moved.max() > 0.05
    free = ~np.array(touched)
    assert np.array(apart)[free].max() <= 1e-9
    assert (np.array(apart) <= 1e-9).mean() >= 0.95
    assert max(apart) <= 1e-5
