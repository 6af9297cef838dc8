"""Wrong input: exit status 2, one clear sentence, and nothing made or overwritten."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from recipe_cases import (
    RL_CO,
    SFT,
    Assets,
    edit_frames,
    refused,
    rename_action,
    start,
    tree,
    with_nan,
)

from rlco.lerobot_files import UNFINISHED_MARK
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import write_effects

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("recipe", "argument", "words"),
    [
        ("record_demos", "episods=3", ["'episods'", "did you mean 'episodes'"]),
        ("sft", "sim_ration=0.5", ["'sim_ration'", "did you mean 'sim_ratio'"]),
        ("sft", "sim_ratio=2", ["sim_ratio", "1"]),
        ("sft", "lr=-1", ["lr", "below the least"]),
        ("sft", "lr=inf", ["lr", "not a finite number"]),
        ("rl_co", "clip=1.5", ["clip", "above the greatest"]),
        ("rl_co", "clip=inf", ["clip", "not a finite number"]),
        ("rl_co", "max_grad_norm=-1", ["max_grad_norm", "below the least"]),
        ("sft", f"seed={2**70}", ["seed", "4294967295"]),
        ("record_demos", f"seed={2**70}", ["seed", "4294967295"]),
        ("sft", "threads=100000", ["threads", "1024"]),
        ("sft", "chunk=100000", ["chunk", "1000"]),
        ("sft", "hidden=[100000000]", ["hidden", "16384"]),
        ("rl_co", "critic_hidden=[100000000]", ["critic_hidden", "16384"]),
        ("sft", "name=../../..", ["name", "a part of a folder's name"]),
        ("quickstart", f"name={'x' * 300}", ["name", "at most 100"]),
        ("quickstart", "methods=[]", ["methods", "is empty"]),
        ("quickstart", "methods=[sft,sft]", ["methods", "twice"]),
        ("record_demos", "task=:x", ["cannot import ''"]),
        ("record_demos", "task=no.module:x", ["cannot import 'no.module'"]),
        ("sft", "lr=4e37", ["lr", "4e+37", "1e+37"]),
        ("rl_co", "critic_lr=4e37", ["critic_lr", "4e+37", "1e+37"]),
        ("rl_co", "real_coef=1", ["'real_coef'", "did you mean 'real_coeff'"]),
        ("evaluate", "episods=3", ["'episods'", "did you mean 'episodes'"]),
        ("quickstart", "itterations=3", ["did you mean 'iterations'"]),
        ("quickstart", "methods=[rlco]", ["'rlco'", "did you mean 'rl_co'"]),
        ("sft", "task=push_cub", ["'push_cub'", "did you mean 'push_cube'"]),
        ("quickstart", "task=push_cub", ["'push_cub'", "did you mean 'push_cube'"]),
        ("record_demos", "task=push_cub", ["did you mean 'push_cube'"]),
        ("record_demos", "domain=standin", ["did you mean 'stand_in'"]),
    ],
)
def test_an_unknown_option_or_name(
    capsys: Capture, tmp_path: Path, recipe: str, argument: str, words: list[str]
) -> None:
    line = refused(capsys, recipe, argument, f"out={tmp_path / 'out'}")
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("recipe", "arguments", "words"),
    [
        ("sft", "hidden=[16384,16384,16384]", "would have 536,870,912 weights"),
        ("sft", "policy=token token.bins=1000000000", "greatest allowed, 65536"),
        ("sft", "policy=token token.layers=100000", "greatest allowed, 32"),
        ("sft", "policy=flow flow.steps=1000000000", "greatest allowed, 1000"),
        ("sft", f"batch_size={10**23}", "greatest allowed, 1000000"),
        ("sft", f"updates={10**30}", f"largest number allowed, {2**63 - 1}"),
        ("sft", "eval_domains=[sim,sim]", "has one of them twice"),
        ("rl_co", "num_envs=1000000000", "greatest allowed, 65536"),
        ("rl_co", "minibatch=100000000000000", "greatest allowed, 1000000"),
        ("rl_co", "horizon=1000000000", "greatest allowed, 100000"),
        ("quickstart", "eval_domains=[]", "[] is empty; give one or more"),
        ("quickstart", "real_domain=standin", "did you mean 'stand_in'"),
    ],
)
def test_what_no_machine_could_train_is_refused(
    capsys: Capture, tmp_path: Path, recipe: str, arguments: str, words: str
) -> None:
    out = tmp_path / "out"
    assert words in refused(capsys, recipe, *arguments.split(), f"out={out}")
    assert not out.exists()


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("1 / 0", "ZeroDivisionError (division by zero) in line 1"),
        ("x = (", "SyntaxError ('(' was never closed) in line 1"),
        ("import sys\nsys.exit(3)", "SystemExit (3) in line 2"),
        ("import no_such_module", "ModuleNotFoundError (No module named 'no_such_"),
    ],
)
def test_a_module_of_ones_own_that_cannot_be_imported(
    capsys: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    code: str,
    said: str,
) -> None:
    name = f"own_{abs(hash(code))}"
    (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    out = tmp_path / "out"
    for argument in (f"task={name}:TASK", f"effects_code={tmp_path / name}.py"):
        line = refused(capsys, "record_demos", argument, f"out={out}")
        assert said in line
        assert f"{name}.py" in line
    assert not out.exists()


def test_no_file_and_no_folder_is_no_log(capsys: Capture, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>"
        "</mujoco>"
    )
    given = [f"model={tmp_path / 'arm.xml'}", "data=/dev/null"]
    line = refused(capsys, "find_gap", *given, f"out={tmp_path / 'out'}")
    assert "'/dev/null' is no file and no folder" in line
    assert not (tmp_path / "out").exists()


def test_a_hidden_effect_that_no_robot_has(capsys: Capture, tmp_path: Path) -> None:
    late = [AppliedEffect("command_delay", None, {"delay": -1.0})]
    write_effects(tmp_path / "late.yaml", late)
    given = [f"hidden={tmp_path / 'late.yaml'}", f"out={tmp_path / 'out'}"]
    assert "delay=-1 s cannot be so small" in refused(capsys, "close_loop", *given)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("recipe", ["record_demos", "compare", "align"])
@pytest.mark.parametrize("place", ["file/out", "x" * 300])
def test_a_place_where_no_folder_can_be(
    capsys: Capture, tmp_path: Path, recipe: str, place: str
) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "two.yaml").write_text(
        "jobs: {one: {recipe: sft, out: run, options: {}}}\ntable: {}\n"
    )
    more = {
        "record_demos": ["episodes=1"],
        "compare": [f"experiment={tmp_path / 'two.yaml'}"],
        "align": ["sim_demos=a", "real_demos=b"],
    }[recipe]
    refused(capsys, recipe, *more, f"out={tmp_path / place}")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["rl_co", "evaluate"])
def test_an_unknown_task_for_a_policy(
    assets: Assets, capsys: Capture, tmp_path: Path, recipe: str
) -> None:
    given = [f"policy={assets.sft / 'policy'}", "task=push_cub"]
    line = refused(capsys, recipe, *given, f"out={tmp_path / 'out'}")
    assert "did you mean 'push_cube'" in line
    assert not (tmp_path / "out").exists()


# -- Data sets -----------------------------------------------------------------


def missing(folder: Path) -> None:
    shutil.rmtree(folder)


def truncated(folder: Path) -> None:
    (file,) = (folder / "data").rglob("*.parquet")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def no_frames(folder: Path) -> None:
    shutil.rmtree(folder / "data")


def other_action_size(folder: Path) -> None:
    info = folder / "meta" / "info.json"
    content = json.loads(info.read_text())
    content["features"]["action"]["shape"] = [6]
    info.write_text(json.dumps(content))


def nan(folder: Path) -> None:
    edit_frames(folder, with_nan)


def unfinished(folder: Path) -> None:
    (folder / UNFINISHED_MARK).touch()


@pytest.mark.parametrize("recipe", ["sft", "rl_co"])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (missing, ["does not exist", "meta/info.json"]),
        (truncated, [".parquet", "copy"]),
        (no_frames, ["missing"]),
        (other_action_size, ["'action'", "6 numbers", "7 are expected"]),
        (nan, ["'action'", "NaN or infinite in 1 of", "frame 2"]),
        (unfinished, ["unfinished recording", "record it again"]),
        (rename_action, ["'action'", "actions", "rename="]),
    ],
)
def test_a_data_set_that_cannot_be_used(
    assets: Assets,
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
    spoil: Callable[[Path], None],
    words: list[str],
) -> None:
    data = tmp_path / "data"
    shutil.copytree(assets.real, data)
    spoil(data)
    before = tree(data) if data.exists() else {}
    given = {
        "sft": [f"sim_demos={assets.sim}", *SFT],
        "rl_co": [f"policy={assets.sft / 'policy'}", *RL_CO],
    }
    options = [*given[recipe], f"real_demos={data}", f"out={tmp_path / 'out'}"]
    line = refused(capsys, recipe, *options)
    for word in (str(data), *words):
        assert word in line, line
    assert not (tmp_path / "out").exists()
    assert (tree(data) if data.exists() else {}) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    "recipe", ["sft", pytest.param("rl_co", marks=pytest.mark.thorough)]
)
def test_renaming_a_feature_makes_such_a_data_set_usable(
    assets: Assets, inputs: dict[str, list[str]], tmp_path: Path, recipe: str
) -> None:
    data = tmp_path / "data"
    shutil.copytree(assets.real, data)
    rename_action(data)
    folder = tmp_path / "out"
    others = [o for o in inputs[recipe] if not o.startswith(("real_", "heldout_"))]
    given = [f"real_demos={data}", "rename=actions:action", f"out={folder}"]
    start(recipe, *others, *given)
    # Under another name it is the same data: so is what is learned from it.
    weights = "policy/policy.safetensors"
    if recipe == "sft":
        assert (folder / weights).read_bytes() == (assets.sft / weights).read_bytes()
    assert (folder / weights).is_file()


def test_a_data_set_that_the_options_need(
    assets: Assets, capsys: Capture, tmp_path: Path
) -> None:
    out = f"out={tmp_path / 'out'}"
    line = refused(capsys, "sft", f"real_demos={assets.real}", out)
    assert "sim_ratio=0.5 needs sim_demos=FOLDER" in line
    policy = f"policy={assets.sft / 'policy'}"
    line = refused(capsys, "rl_co", policy, out)
    assert "needs real_demos=FOLDER" in line
    for given in (("sft", "sim_ratio=0"), ("rl_co", policy)):
        demos = f"real_demos={assets.real}"
        line = refused(capsys, *given, demos, "real_camera=front", out)
        assert "real_camera='front' names images, but the policy reads none" in line
    assert not (tmp_path / "out").exists()


# -- Folders and checkpoints ---------------------------------------------------


@pytest.mark.parametrize("recipe", ["record_demos", "sft", "rl_co", "evaluate"])
def test_an_existing_output_folder_is_left_as_it_is(
    assets: Assets,
    inputs: dict[str, list[str]],
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "metrics.csv").write_text("precious")
    others = {"record_demos": ["episodes=1"], "evaluate": [], **inputs}
    if recipe == "evaluate":
        others[recipe] = [f"policy={assets.sft / 'policy'}", "episodes=1"]
    line = refused(capsys, recipe, *others[recipe], f"out={kept}")
    assert f"{str(kept)!r} exists and is not overwritten" in line
    assert tree(kept) == {"metrics.csv": b"precious"}


def other_architecture(policy: Path) -> None:
    description = next(policy.glob("*.json"))
    content = json.loads(description.read_text())
    content["arguments"]["hidden"] = [8]
    del content["checksum"]
    description.write_text(json.dumps(content))


def other_task(policy: Path) -> None:
    description = next(policy.glob("*.json"))
    content = json.loads(description.read_text())
    content["kind"] = "gausian"
    del content["checksum"]
    description.write_text(json.dumps(content))


def not_a_policy(policy: Path) -> None:
    for file in policy.iterdir():
        file.unlink()


def cut_off(policy: Path) -> None:
    (weights,) = policy.glob("*.safetensors")
    weights.write_bytes(weights.read_bytes()[:100])


@pytest.mark.parametrize("recipe", ["rl_co", "evaluate"])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (other_architecture, ["is of another architecture", "has shape"]),
        (other_task, ["did you mean 'gaussian'"]),
        (not_a_policy, ["policy.json", "give the folder of a saved policy"]),
        (cut_off, ["file of weights", "damaged"]),
        (shutil.rmtree, ["is missing", "give the folder of a saved policy"]),
    ],
)
def test_a_checkpoint_that_does_not_fit(
    assets: Assets,
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
    spoil: Callable[[Path], None],
    words: list[str],
) -> None:
    policy = tmp_path / "policy"
    shutil.copytree(assets.sft / "policy", policy)
    spoil(policy)
    given = [f"policy={policy}", f"out={tmp_path / 'out'}"]
    if recipe == "rl_co":
        given += [f"real_demos={assets.real}", *RL_CO]
    line = refused(capsys, recipe, *given)
    for word in (str(policy), *words):
        assert word in line, line
    assert not (tmp_path / "out").exists()


def test_resuming_what_is_no_run(capsys: Capture, tmp_path: Path) -> None:
    line = refused(capsys, "sft", f"resume={tmp_path}")
    assert "is not a run directory" in line
    assert tree(tmp_path) == {}


def test_resuming_a_run_of_another_recipe(assets: Assets, capsys: Capture) -> None:
    before = tree(assets.sft)
    refused(capsys, "rl_co", f"resume={assets.sft}")
    assert tree(assets.sft) == before
