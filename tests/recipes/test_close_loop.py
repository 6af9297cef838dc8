"""The loop: what is hidden is found from logs alone, and training uses it."""

from __future__ import annotations

import functools
import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recipe_cases import refused, start

import rlco.gap
from rlco.gap.model import load_model
from rlco.gap.practice_arm import write_known_model
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.effects_file import read_effects, write_effects

pytestmark = pytest.mark.slow

TINY = (
    "seeds=[3]",
    "seconds=4",
    "demos=1",
    "updates=2",
    "eval_episodes=2",
    "policy=token",
    "token.width=16",
    "token.bins=16",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop") / "run"
    # What could stand in for the offset; a search through all effects takes twice it.
    known = {"joint_offset", "torque_bias", "encoder_scale", "command_delay", "payload"}
    few = functools.partial(rlco.gap.run_gap, exclude=set(EFFECTS) - known)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rlco.gap, "run_gap", few)
        start("close_loop", *TINY, f"out={folder}")
    return folder


@pytest.mark.thorough
def test_what_is_hidden_is_found_from_the_logs(run: Path) -> None:
    (hidden,) = read_effects(run / "hidden.yaml").effects
    (found,) = read_effects(run / "gap" / "effects.yaml").effects
    assert found.name == hidden.name == "joint_offset"
    assert found.target == "robot0_joint2"
    assert found.parameters["offset"] == pytest.approx(0.05, abs=0.005)
    report = json.loads((run / "gap" / "report.json").read_text())
    assert report["verdict"] in ("named", "ambiguous")
    gap = report["gap"]
    assert gap["after"]["heldout_rms"] < 0.5 * gap["before"]["heldout_rms"]


@pytest.mark.thorough
def test_logs_hold_what_a_robot_could_tell(run: Path) -> None:
    files = sorted((run / "logs").glob("*.npz"))
    assert len(files) == 6
    with np.load(files[0]) as log:
        assert sorted(log) == ["joint_names", "position", "time", "torque"]
        assert log["position"].shape == log["torque"].shape == (400, 7)
        # The arm moved, freely, within its torques.
        assert np.ptp(log["position"], axis=0).min() > 0.05
        assert np.abs(log["torque"]).max() < 80.0
    # The model that they are compared with has nothing of what is hidden.
    assert "joint_offset" not in (run / "nominal.xml").read_text()


@pytest.mark.thorough
def test_each_method_is_trained_and_evaluated_where_the_effect_is(run: Path) -> None:
    rows = json.loads((run / "results.json").read_text())["rows"]
    assert [row["method"] for row in rows] == ["nominal", "corrected", "oracle"]
    assert {(row["domain"], row["seed"], row["episodes"]) for row in rows} == {
        ("stand_in", 3, 2)
    }
    assert {row["policy"] for row in rows} == {"token"}
    # The same episodes, but under the effect the arm goes another way.
    first = {
        method: (run / "demos" / f"{method}_s3" / "data/chunk-000/file-000.parquet")
        for method in ("nominal", "corrected", "oracle")
    }
    assert first["nominal"].read_bytes() != first["oracle"].read_bytes()
    page = (run / "report.html").read_text()
    for word in ("nominal", "corrected", "oracle", "joint_offset", "No robot moved"):
        assert word in page
    assert (run / "plots" / "success.png").stat().st_size > 1000


def test_what_is_won_back_is_reported_as_a_share_of_what_was_lost() -> None:
    module: Any = importlib.import_module("close_loop")

    def row(method: str, seed: int, successes: int) -> dict[str, Any]:
        return {
            "method": method,
            "seed": seed,
            "successes": successes,
            "episodes": 10,
        }

    rows = [
        row(method, seed, successes)
        for method, both in {
            "nominal": (2, 4),
            "corrected": (7, 7),
            "oracle": (9, 7),
        }.items()
        for seed, successes in enumerate(both)
    ]
    # 0.3, 0.7 and 0.8 in the mean: 0.4 of 0.5 is won back.
    found = module.shrinkage(rows)
    assert found == (pytest.approx(0.5), pytest.approx(0.8))
    assert "50 points below" in module.result_of(*found)
    assert "80 % of that is won back" in module.result_of(*found)
    # A share of nothing is none.
    swapped = {"nominal": "oracle", "oracle": "nominal", "corrected": "corrected"}
    turned = [{**one, "method": swapped[one["method"]]} for one in rows]
    for other in (turned, [row(method, 0, 5) for method in swapped]):
        words = module.result_of(*module.shrinkage(other))
        assert words.endswith("is no lower than trained where the effect is.")


def test_another_effect_may_be_hidden(tmp_path: Path) -> None:
    module: Any = importlib.import_module("close_loop")
    mine = tmp_path / "mine.yaml"
    tilt = AppliedEffect("gravity_tilt", None, {"roll": 0.05, "pitch": 0.0})
    write_effects(mine, [tilt])
    config = module.Config(hidden=str(mine))
    assert module.hide(config, tmp_path / "hidden.yaml") == [tilt]
    assert read_effects(tmp_path / "hidden.yaml").effects == (tilt,)


def test_a_model_that_exists_is_not_overwritten(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    model = tmp_path / "arm.xml"
    model.write_text("mine")
    out = tmp_path / "logs"
    line = refused(capsys, "record_logs", f"out={out}", f"model={model}")
    assert "exists and is not overwritten" in line
    assert model.read_text() == "mine"
    assert not out.exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["out=/proc/logs"], "output folder '/proc/logs' cannot be made"),
        (["model=/proc/arm.xml"], "file '/proc/arm.xml' cannot be made"),
        (["model=file/arm.xml"], "'file/arm.xml' cannot be made (Not a directory)"),
        (["model=logs"], "model='logs' and out='logs/1' would be a file and a folder"),
        (["seconds=1e300"], "option seconds: 1e+300 is above the greatest"),
        (["recordings=101"], "option recordings: 101 is above the greatest"),
    ],
)
def test_what_cannot_be_written_is_told_before_anything_is_recorded(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    given: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    out = [] if given[0].startswith("out=") else ["out=logs/1"]
    assert words in refused(capsys, "record_logs", *out, *given)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("hidden=no.yaml", "file 'no.yaml' is missing"),
        ("hidden=other.yaml", "unknown target of an effect 'no_such_joint'"),
        ("seeds=[]", "option seeds: [] is empty"),
        ("seeds=[0,0]", "option seeds: [0, 0] has one of them twice"),
    ],
)
def test_what_cannot_be_hidden_is_told_before_a_folder_is_made(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    given: str,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    elsewhere = AppliedEffect("joint_offset", "no_such_joint", {"offset": 0.05})
    write_effects(Path("other.yaml"), [elsewhere])
    assert words in refused(capsys, "close_loop", *TINY[1:], "out=loop", given)
    assert not Path("loop").exists()


def test_a_known_model_makes_its_folder_and_leaves_nothing_beside_it(
    tmp_path: Path,
) -> None:
    model = tmp_path / "models" / "arm.xml"
    write_known_model(model, "push_cube")
    assert [path.name for path in model.parent.iterdir()] == ["arm.xml"]
    assert load_model(model).model.nu == 9
