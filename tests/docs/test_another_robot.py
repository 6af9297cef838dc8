"""The program for a robot that rlco has no task for does what its page says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from reacher import EPISODE, co_train, record, robot, simulator, teleoperate, worlds
from recipe_cases import start

from rlco.data import load_demos
from rlco.policies import load_policy


@pytest.mark.parametrize("make", [simulator, robot])
def test_its_teleoperation_reaches_the_target(
    make: Callable[[], gymnasium.Env[np.ndarray, np.ndarray]],
) -> None:
    arm, reached = make(), 0
    for episode in range(20):
        state, _ = arm.reset(seed=episode)
        for _ in range(EPISODE):
            state = arm.step(teleoperate(state))[0]
        reached += np.linalg.norm(state[-2:]) < 0.02
    assert reached >= 18


@pytest.mark.slow
def test_stage_two_starts_from_the_policy_of_the_recipe(tmp_path: Path) -> None:
    demos = tmp_path / "demos"
    record(str(demos), robot(), episodes=4, seed=0)
    run = tmp_path / "run"
    start("sft", "task=null", f"real_demos={demos}", "updates=50", f"out={run}")
    policy, extra = load_policy(run / "policy")
    assert extra["task"] is None
    assert extra["state_names"][-1] == "error.y"
    # The environment executes what the policy says, in the demonstrations' units.
    env = worlds(simulator, num_envs=1, chunk=policy.chunk)
    rows = load_demos(demos, chunk=policy.chunk).frames()
    assert bool(env.action_spec.is_in(rows["vla_action", "chunk"][:1]))
    before = [weights.clone() for weights in policy.parameters()]
    co_train(policy, str(demos), real_coeff=0.2, iterations=1, num_envs=2)
    assert any(
        not torch.equal(old, new)
        for old, new in zip(before, policy.parameters(), strict=True)
    )
