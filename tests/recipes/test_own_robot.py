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
#: sim_ratio and eval_episodes follow from task=null.
OWN = ("task=null", *(o for o in SFT if not o.startswith("eval_episodes")))


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
        (["episodes=9"], ["episodes=9 of", "asks for 9, which", "out of 0-1"]),
        (["episodes=0-2"], ["episodes=0-2 of", "asks for 2, which", "out of 0-1"]),
        (["episodes=0,1,0"], ["asks for 0 more than once"]),
        (["episodes=1-0"], ["episodes='1-0' is no list", "episodes=0-19,25"]),
        (["episodes=0:1"], ["episodes='0:1' is no list", "episodes=0-19,25"]),
        (
            ["sim_episodes=0:1"],
            ["sim_episodes='0:1' is no list", "sim_episodes=0-19,25"],
        ),
        (["eval_episodes=4"], ["task=null", "eval_episodes=4", "eval_episodes=0"]),
        (["sim_ratio=0.5"], ["sim_ratio=0.5 needs sim_demos=FOLDER"]),
        (["heldout_episodes=1"], ["heldout_episodes=1 needs heldout_demos=FOLDER"]),
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


def test_a_batch_that_cannot_hold_both_kinds_is_refused_first(
    tmp_path: Path, capsys: Capture
) -> None:
    data = write_arm(tmp_path / "arm")
    rest = [o for o in OWN if not o.startswith("batch_size=")]
    both = [f"sim_demos={data}", f"real_demos={data}", "sim_ratio=0.9", "batch_size=8"]
    line = refused(capsys, "sft", *rest, *both, f"out={tmp_path / 'run'}")
    assert "batch_size=8 is too small for sim_ratio=0.9: at least 10 rows" in line
    assert not (tmp_path / "run").exists()


def test_positions_are_learned_from_data_that_have_some(
    tmp_path: Path, capsys: Capture
) -> None:
    data = write_arm(tmp_path / "arm", poses=False, camera="front")
    options = ["image=dense", "position_coeff=0.5", "use_environment_state=false"]
    both = [f"sim_demos={data}", f"real_demos={data}", "sim_ratio=0.5"]
    given = [*OWN, *options, *both, f"out={tmp_path / 'run'}"]
    line = refused(capsys, "sft", *given)
    assert "'observation.environment_state'" in line
    assert "position_coeff" in line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("inner", ["data", "data/chunk-000", "meta", "above"])
def test_a_folder_inside_or_above_names_the_data_set(
    tmp_path: Path, capsys: Capture, inner: str
) -> None:
    data = write_arm(tmp_path / "all" / "arm")
    given = tmp_path / "all" if inner == "above" else data / inner
    line = refused(
        capsys, "sft", *OWN, f"real_demos={given}", f"out={tmp_path / 'run'}"
    )
    assert repr(str(data)) in line


def test_what_is_held_out_is_not_trained_on(tmp_path: Path, capsys: Capture) -> None:
    data = write_arm(tmp_path / "arm", episodes=4)
    given = [f"real_demos={data}", f"heldout_demos={data}", f"out={tmp_path / 'run'}"]
    line = refused(capsys, "sft", *OWN, *given, "episodes=0-2", "heldout_episodes=2,3")
    assert "episodes 2 of" in line
    assert "heldout_episodes=" in line


def test_a_held_out_robot_must_be_the_same(tmp_path: Path, capsys: Capture) -> None:
    six = write_arm(tmp_path / "six")
    five = write_arm(tmp_path / "five", joints=5)
    given = [f"real_demos={six}", f"heldout_demos={five}", f"out={tmp_path / 'run'}"]
    line = refused(capsys, "sft", *OWN, *given)
    assert "heldout_demos has 5" in line


def test_errors_on_held_out_demonstrations_are_known_in_degrees(
    tmp_path: Path, capsys: Capture
) -> None:
    data = write_arm(tmp_path / "arm", scale=90.0, episodes=3)
    out = tmp_path / "run"
    start(
        "sft",
        *OWN,
        f"real_demos={data}",
        "episodes=0-1",
        f"heldout_demos={data}",
        "heldout_episodes=2",
        f"out={out}",
    )
    policy, _ = load_policy(out / "policy")
    frames = load_demos(data, chunk=4, episodes=[2]).frames()
    frames["instruction_id"].zero_()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        acted = policy(frames.select(*policy.in_keys))["action"]
    off = (acted - frames["vla_action", "chunk"]).abs()[~frames["action_is_pad"]]
    result = json.loads((out / "results.json").read_text())
    assert result["rows"] == []  # no success was counted, as compare and report know
    train, held = result["imitation"]
    assert (train["data"], held["data"]) == ("real_demos", "heldout_demos")
    assert (train["frames"], held["frames"]) == (24, 12)
    assert held["task"] is None
    expected = {f"joint{i}": error for i, error in enumerate(off.mean(0).tolist())}
    assert held["action_error"] == pytest.approx(expected, rel=1e-4)
    last = read_metrics(out / "metrics.csv")[-1]
    assert last["imitation_error_heldout"] == pytest.approx(held["imitation_error"])
    said = capsys.readouterr().err
    assert f"heldout_demos: imitation error {held['imitation_error']:.3g}" in said
    assert "sft: 6 of 6 updates" in said


def test_measuring_held_out_errors_changes_no_training(tmp_path: Path) -> None:
    data = write_arm(tmp_path / "arm", episodes=3)
    given = [*OWN, "policy=flow", f"real_demos={data}", "episodes=0-1"]
    held = [f"heldout_demos={data}", "heldout_episodes=2"]
    for name, more in {"without": [], "with": held}.items():
        start("sft", *given, *more, f"out={tmp_path / name}")
    weights = [
        (tmp_path / name / "policy" / "policy.safetensors").read_bytes()
        for name in ("without", "with")
    ]
    assert weights[0] == weights[1]


def test_two_robots_do_not_mix(tmp_path: Path, capsys: Capture) -> None:
    six = write_arm(tmp_path / "six")
    five = write_arm(tmp_path / "five", joints=5)
    given = [f"sim_demos={six}", f"real_demos={five}", f"out={tmp_path / 'run'}"]
    line = refused(capsys, "sft", *OWN, *given)
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


@pytest.mark.parametrize(
    ("poses", "camera", "more", "said"),
    [
        (False, "front", (), True),
        (False, "front", ("image=conv",), False),
        (True, "front", (), False),
        (False, None, (), False),
    ],
)
def test_a_policy_that_sees_no_object_is_said_to_be_blind(
    tmp_path: Path,
    capsys: Capture,
    poses: bool,
    camera: str | None,
    more: tuple[str, ...],
    said: bool,
) -> None:
    data = write_arm(tmp_path / "arm", joints=2, poses=poses, camera=camera)
    out = tmp_path / "run"
    capsys.readouterr()
    start("sft", *OWN, f"real_demos={data}", f"out={out}", *more)
    lines = [line for line in capsys.readouterr().err.splitlines() if "has im" in line]
    assert len(lines) == said
    for line in lines:
        assert "(joint0, joint1) cannot see objects" in line
        assert "image=conv" in line


def test_metrics_are_those_of_any_stage_one(tmp_path: Path) -> None:
    data = write_arm(tmp_path / "arm")
    start("sft", *OWN, f"real_demos={data}", f"out={tmp_path / 'run'}")
    rows = read_metrics(tmp_path / "run" / "metrics.csv")
    assert [row["updates"] for row in rows] == [2, 4, 6]
    assert json.loads((tmp_path / "run" / "results.json").read_text())["rows"] == []
