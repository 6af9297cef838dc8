"""Data of a robot that no simulator has: sizes from the data, no evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from arm_cases import write_arm
from recipe_cases import SFT, refused, start
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.data import load_demos
from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics

Capture = pytest.CaptureFixture[str]
OWN = ("task=null", "sim_ratio=0", *SFT)


@pytest.mark.slow
def test_joint_angles_in_degrees_are_imitated_in_degrees(tmp_path: Path) -> None:
    data = write_arm(tmp_path / "arm", scale=90.0, frames=40)
    rest = [o for o in OWN if not o.startswith(("updates", "hidden"))]
    start(
        "sft",
        *rest,
        "updates=200",
        "lr=1e-2",
        "hidden=[32]",
        "gaussian.imitation=mse",
        f"real_demos={data}",
        f"out={tmp_path / 'run'}",
    )
    policy, extra = load_policy(tmp_path / "run" / "policy")
    assert extra["task"] is None
    assert extra["instructions"] == ["sort the screws"]
    assert extra["control_frequency"] == 30
    assert extra["action_names"] == [f"joint{i}" for i in range(6)]
    frames = load_demos(data, chunk=4).frames()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        acted = policy(frames.select(*policy.in_keys))["action"]
    error = (acted - frames["vla_action", "chunk"])[~frames["action_is_pad"]]
    assert acted.abs().max() > 60.0
    assert error.abs().mean() < 20.0


def test_only_the_episodes_asked_for_are_trained_on(tmp_path: Path) -> None:
    data = write_arm(tmp_path / "arm", scale=0.9, episodes=4, texts=("a", "b"))
    out = f"out={tmp_path / 'run'}"
    start("sft", *OWN, f"real_demos={data}", "episodes=1,3", out)
    # The policy's range is that of the episodes trained on.
    policy, _ = load_policy(tmp_path / "run" / "policy")
    chosen = load_demos(data, episodes=[1, 3]).frames()["action"].double().numpy()
    bound = torch.quantile(torch.from_numpy(chosen), 0.99, dim=0)
    torch.testing.assert_close(policy.action_normalizer.high, bound.float())


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["episodes=9"], ["episodes=[9]", "0-1"]),
        (["episodes=1-0"], ["'1-0'", "0-19,25"]),
        (["eval_episodes=4"], ["task=null", "eval_episodes=0"]),
    ],
)
def test_what_such_a_robot_cannot_have(
    tmp_path: Path, capsys: Capture, given: list[str], words: list[str]
) -> None:
    data = write_arm(tmp_path / "arm")
    name = given[0].partition("=")[0]
    rest = [o for o in OWN if not o.startswith(f"{name}=")]
    out = tmp_path / "run"
    line = refused(capsys, "sft", *rest, *given, f"real_demos={data}", f"out={out}")
    for word in words:
        assert word in line
    assert not out.exists()


def test_two_robots_do_not_mix(tmp_path: Path, capsys: Capture) -> None:
    six = write_arm(tmp_path / "six")
    five = write_arm(tmp_path / "five", joints=5)
    rest = [o for o in OWN if not o.startswith("sim_ratio")]
    given = [f"sim_demos={six}", f"real_demos={five}", f"out={tmp_path / 'run'}"]
    line = refused(capsys, "sft", *rest, *given)
    assert "sim_demos has 6 numbers in 'observation.state' and real_demos has 5" in line


def test_another_robots_data_say_how_to_train_on_them(
    tmp_path: Path, capsys: Capture
) -> None:
    data = write_arm(tmp_path / "arm")
    given = ["sim_ratio=0", *SFT, f"real_demos={data}", f"out={tmp_path / 'run'}"]
    assert "task=null" in refused(capsys, "sft", *given)


def test_a_policy_of_another_robot_is_not_taken_into_a_simulator(
    tmp_path: Path, capsys: Capture
) -> None:
    data = write_arm(tmp_path / "arm", joints=7, fps=20)
    start("sft", *OWN, f"real_demos={data}", f"out={tmp_path / 'run'}")
    policy = tmp_path / "run" / "policy"
    saved = json.loads((policy / "policy.json").read_text())["arguments"]
    assert saved["action_limit"] is None
    line = refused(capsys, "evaluate", f"policy={policy}", f"out={tmp_path / 'e'}")
    assert "trained without a simulator (task=null)" in line


def test_metrics_are_those_of_any_stage_one(tmp_path: Path) -> None:
    data = write_arm(tmp_path / "arm")
    start("sft", *OWN, f"real_demos={data}", f"out={tmp_path / 'run'}")
    rows = read_metrics(tmp_path / "run" / "metrics.csv")
    assert [row["updates"] for row in rows] == [2, 4, 6]
    assert json.loads((tmp_path / "run" / "results.json").read_text())["rows"] == []
