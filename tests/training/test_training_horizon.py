"""Training episodes last as long as the task needs, and say where they are cut off."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import pytest

from rlco.collectors import make_collector
from rlco.data import load_demos, record_demonstrations
from rlco.physics.tasks import push_cube
from rlco.policies import GaussianPolicy
from rlco.training.options.stage_two_options import StageTwoOptions
from rlco.training.stage_two import rollout_rows, warn_of_cut_off

SLOW = replace(push_cube.TASK, name="slow", horizon=150, training_horizon=None)


def options(task: str, horizon: int | None = None) -> StageTwoOptions:
    given = {} if horizon is None else {"horizon": horizon}
    return StageTwoOptions(
        policy="", task=task, num_envs=2, advantage="mc", group_size=2, **given
    )


@pytest.mark.parametrize(
    ("task", "horizon", "steps"),
    [
        ("push_cube", None, 64),  # the quickstart's
        (f"{__name__}:SLOW", None, 150),
        ("push_cube", 20, 20),
    ],
)
def test_training_episodes_are_as_long_as_the_task_says(
    task: str, horizon: int | None, steps: int
) -> None:
    given = options(task, horizon)
    assert rollout_rows(given, chunk=4) == 2 * -(-steps // 4)
    policy = GaussianPolicy(
        7, chunk=4, environment_state_size=12, num_instructions=3, hidden=(8,)
    )
    collector = make_collector(given, policy, None, chunk=4, image_size=None)
    assert collector.env.horizon == steps
    assert collector.frames == 2 * steps
    collector.close()


@pytest.mark.slow
def test_a_horizon_that_cuts_off_most_demonstrations_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger("rlco"), "propagate", True)
    record_demonstrations(tmp_path / "d", "push_cube", "sim", episodes=3, seed=1)
    demos = load_demos(tmp_path / "d")
    longest = max(demos.meta.episode_lengths)
    warn_of_cut_off(longest, demos)
    assert "last longer" not in caplog.text
    warn_of_cut_off(20, demos)
    assert "3 of 3 demonstrations" in caplog.text
    assert f"the longest {longest} control steps" in caplog.text
