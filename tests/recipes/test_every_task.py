"""The chain of recipes runs on tasks that are not its default, a user's among them."""

from __future__ import annotations

from pathlib import Path

import pytest
from recipe_cases import RL_CO, SFT, start

from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.tasks.make_task import make_task
from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics

DOCS = Path(__file__).parents[2] / "docs"
NOT_DEFAULT = (*TASK_NAMES[1:], "reach:TASK")
LEFT_OUT = ("iterations", "critic_iterations", "eval_episodes", "eval_every")


@pytest.mark.slow
@pytest.mark.parametrize("task", NOT_DEFAULT)
def test_record_imitate_and_reinforce(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(DOCS))  # where reach.py lies
    demos, sft, rl_co = (tmp_path / name for name in ("demos", "sft", "rl_co"))
    named = f"task={task}"
    start("record_demos", named, "domain=stand_in", "episodes=2", f"out={demos}")
    start("sft", named, f"real_demos={demos}", "sim_ratio=0", *SFT, f"out={sft}")
    rest = [o for o in RL_CO if not o.startswith(LEFT_OUT)]
    more = ("iterations=1", "critic_iterations=0", "horizon=16", "eval_episodes=0")
    given = (f"policy={sft / 'policy'}", f"real_demos={demos}")
    start("rl_co", named, *given, *rest, *more, f"out={rl_co}")

    last = read_metrics(rl_co / "metrics.csv")[-1]
    assert last["frames"] == 2 * 16
    assert last["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert last["grad_norm_sim"] > 0.0
    assert last["grad_norm_real"] > 0.0
    _, extra = load_policy(rl_co / "policy")
    own = make_task(task)
    assert extra["task"] == own.name
    assert extra["instructions"] == list(own.instructions)
    assert extra["environment_state_names"] == list(own.environment_state_names)
