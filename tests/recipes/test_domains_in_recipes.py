"""Domains from files through the recipes: to train in, to evaluate in, to record in."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from recipe_cases import RECIPES, RL_CO, SFT, Assets, refused, start

from rlco.physics.effects import EFFECTS, AppliedEffect, load_code
from rlco.physics.effects.effects_file import write_effects
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.runs.metrics import read_metrics

pytestmark = pytest.mark.slow

Capture = pytest.CaptureFixture[str]
DRAG = RECIPES.parent / "docs" / "my_effect.py"
QUICK = (
    "sim_demos=1",
    "real_demos=1",
    "heldout_demos=1",
    "updates=2",
    "iterations=1",
    "num_envs=2",
    "eval_every=1",
    "curve_episodes=2",
    "eval_episodes=2",
    "film=false",
)


@pytest.fixture(scope="module")
def damped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write what find_gap writes of an arm whose fourth joint is damped."""
    file = tmp_path_factory.mktemp("gap") / "damped.yaml"
    damping = AppliedEffect("viscous_damping", "joint4", {"damping": 40.0})
    units = {"viscous_damping": {"damping": "N m s/rad"}}
    write_effects(file, [damping], units=units)
    return file


@pytest.fixture
def dragged(tmp_path: Path) -> Iterator[Path]:
    """Write a file with an effect that docs/my_effect.py registers, and forget it."""
    file = tmp_path / "dragged.yaml"
    try:
        load_code(DRAG)
        drag = AppliedEffect("quadratic_drag", "joint4", {"drag": 40.0})
        write_effects(file, [drag])
        EFFECTS.pop("quadratic_drag", None)
        yield file
    finally:
        EFFECTS.pop("quadratic_drag", None)


def rows(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "results.json").read_text())[
        "rows"
    ]
    return found


def but(options: tuple[str, ...], *names: str) -> list[str]:
    """Return options without those of these names."""
    return [o for o in options if o.partition("=")[0] not in names]


def stage_two(assets: Assets) -> list[str]:
    return [f"policy={assets.sft / 'policy'}", f"real_demos={assets.real}"]


# -- Where a recipe trains and evaluates -------------------------------------------


@pytest.mark.thorough
def test_rl_trains_in_the_simulator_that_a_file_describes(
    assets: Assets, damped: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "rl"
    given = [*stage_two(assets), f"heldout_demos={assets.real}"]
    given += [*but(RL_CO, "eval_domains"), f"eval_domains=[sim,{damped}]"]
    start("rl_co", *given, f"train_domain={damped}", f"out={folder}")
    in_sim, in_file = (read_metrics(f / "metrics.csv") for f in (assets.rl_co, folder))
    # The same policy plays the same episodes, but the arm goes another way.
    assert in_file[0]["success_sim"] == in_sim[0]["success_sim"]
    assert in_file[1]["return_mean"] != in_sim[1]["return_mean"]
    assert "success_damped" in in_file[0]
    assert [row["domain"] for row in rows(folder)] == ["sim", "damped"]
    saved = yaml.safe_load((folder / "config.yaml").read_text())
    assert saved["train_domain"] == str(damped)


def test_a_file_to_evaluate_in_is_sim_with_its_effects(
    assets: Assets, damped: Path, tmp_path: Path
) -> None:
    given = [f"policy={assets.rl_co / 'policy'}", "episodes=3"]
    start("evaluate", *given, f"domain={damped}", f"out={tmp_path / 'file'}")
    start("evaluate", *given, f"effects={damped}", f"out={tmp_path / 'effects'}")
    (by_file,), (by_effects,) = rows(tmp_path / "file"), rows(tmp_path / "effects")
    assert by_file.pop("domain") == "damped"
    assert by_effects.pop("domain") == "sim"
    assert by_file == by_effects


@pytest.mark.thorough
def test_stage_one_is_evaluated_in_files(
    assets: Assets, damped: Path, tmp_path: Path
) -> None:
    given = [f"sim_demos={assets.sim}", "sim_ratio=1", *but(SFT, "eval_episodes")]
    domains = f"eval_domains=[{damped},stand_in]"
    start("sft", *given, "eval_episodes=2", domains, f"out={tmp_path / 'sft'}")
    assert [r["domain"] for r in rows(tmp_path / "sft")] == ["damped", "stand_in"]


@pytest.mark.thorough
def test_quickstart_trains_and_compares_in_files(damped: Path, tmp_path: Path) -> None:
    folder = tmp_path / "quick"
    domains = [f"train_domain={damped}", f"eval_domains=[{damped},stand_in]"]
    start("quickstart", *QUICK, *domains, f"out={folder}")
    assert {row["domain"] for row in rows(folder)} == {"damped", "stand_in"}
    robots = {
        name: json.loads((folder / "data" / name / "meta" / "info.json").read_text())[
            "robot_type"
        ]
        for name in ("sim", "real", "heldout")
    }
    assert robots == {
        "sim": "panda_damped",
        "real": "panda_stand_in",
        "heldout": "panda_stand_in",
    }
    stage = folder / "stages" / "rl_co"
    assert "success_damped" in read_metrics(stage / "metrics.csv")[0]
    # The stage is what rl_co.py does with its options.
    alone = tmp_path / "alone"
    start("rl_co", f"config={stage / 'config.yaml'}", f"out={alone}")
    for name in ("metrics.csv", "policy/policy.safetensors"):
        assert (alone / name).read_bytes() == (stage / name).read_bytes(), name


@pytest.mark.thorough
def test_a_lerobot_checkpoint_is_co_trained_in_a_file(
    damped: Path, tmp_path: Path, rendering: None
) -> None:
    del rendering
    tiny = write_tiny_smolvla(tmp_path / "tiny")
    given = ["config=debug", f"policy={tiny}", "real_coeff=0", "horizon=8"]
    given += ["iterations=1", "eval_episodes=1", "eval_every=1", "num_envs=2"]
    returns = {}
    for domain in ("sim", str(damped)):
        folder = tmp_path / Path(domain).stem
        where = [f"train_domain={domain}", f"eval_domains=[{domain}]"]
        start("lerobot_co_train", *given, *where, f"out={folder}")
        with (folder / "metrics.csv").open() as file:
            _, last = csv.DictReader(file)
        assert f"success_{folder.name}" in last
        returns[domain] = float(last["return_mean"])
    assert returns["sim"] != returns[str(damped)]


# -- The domain of final tables ----------------------------------------------------


@pytest.mark.parametrize("recipe", ["rl_co", "quickstart", "lerobot_co_train"])
@pytest.mark.parametrize("name", ["locked", "rlco.physics.spec.domain:LOCKED"])
def test_no_rl_in_the_domain_of_final_tables(
    inputs: dict[str, list[str]],
    assets: Assets,
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
    name: str,
) -> None:
    out = tmp_path / "out"
    given = inputs.get(recipe, [])
    if recipe == "lerobot_co_train":
        given = [f"policy={assets.sft / 'policy'}", "real_coeff=0"]
    line = refused(capsys, recipe, *given, f"train_domain={name}", f"out={out}")
    assert f"train_domain={name!r} is for final evaluations alone" in line
    assert not out.exists()


def test_demonstrations_are_recorded_and_policies_evaluated_in_locked(
    assets: Assets, tmp_path: Path
) -> None:
    demos, out = tmp_path / "demos", tmp_path / "out"
    start("record_demos", "domain=locked", "episodes=1", f"out={demos}")
    info = json.loads((demos / "meta" / "info.json").read_text())
    assert info["robot_type"] == "panda_locked"
    given = [f"policy={assets.sft / 'policy'}", "episodes=2", "domain=locked"]
    start("evaluate", *given, f"out={out}")
    assert [row["domain"] for row in rows(out)] == ["locked"]


# -- Effects of one's own ----------------------------------------------------------


@pytest.mark.thorough
def test_an_effect_of_ones_own_goes_through_the_chain(
    dragged: Path, tmp_path: Path
) -> None:
    code = f"effects_code={DRAG}"
    demos, sft, rl = (tmp_path / name for name in ("demos", "sft", "rl"))
    start("record_demos", f"domain={dragged}", code, "episodes=1", f"out={demos}")
    EFFECTS.pop("quadratic_drag")  # as in a process of its own
    given = [f"sim_demos={demos}", "sim_ratio=1", *but(SFT, "eval_episodes"), code]
    start("sft", *given, "eval_episodes=1", f"eval_domains=[{dragged}]", f"out={sft}")
    EFFECTS.pop("quadratic_drag")
    given = [f"policy={sft / 'policy'}", f"real_demos={demos}", code, "horizon=16"]
    given += but(RL_CO, "iterations", "critic_iterations", "eval_domains")
    given += ["iterations=1", "critic_iterations=0", f"eval_domains=[{dragged}]"]
    start("rl_co", *given, f"train_domain={dragged}", f"out={rl}")
    EFFECTS.pop("quadratic_drag")
    given = [f"policy={rl / 'policy'}", "episodes=1", code]
    start("evaluate", *given, f"domain={dragged}", f"out={tmp_path / 'evaluation'}")
    for folder in (sft, rl, tmp_path / "evaluation"):
        assert [row["domain"] for row in rows(folder)] == ["dragged"]


def test_an_effect_that_no_code_has_registered_is_refused(
    dragged: Path, capsys: Capture, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    line = refused(capsys, "record_demos", f"domain={dragged}", f"out={out}")
    assert "'quadratic_drag'" in line
    assert not out.exists()


# -- What cannot be ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("recipe", "option"),
    [
        ("record_demos", "domain={}"),
        ("sft", "eval_domains=[sim,{}]"),
        ("rl_co", "eval_domains=[{}]"),
        ("rl_co", "train_domain={}"),
        ("evaluate", "domain={}"),
        ("quickstart", "eval_domains=[{}]"),
        ("quickstart", "train_domain={}"),
        ("close_loop", "simulator={}"),
        ("lerobot_co_train", "eval_domains=[{}]"),
        ("lerobot_co_train", "train_domain={}"),
    ],
)
@pytest.mark.parametrize("path", ["nowhere.yaml", "no_such_name"])
def test_a_domain_that_is_not_there_is_refused_before_anything_starts(
    assets: Assets,
    inputs: dict[str, list[str]],
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
    option: str,
    path: str,
) -> None:
    given = inputs.get(recipe, [])
    if recipe in ("evaluate", "lerobot_co_train"):
        given = [f"policy={assets.sft / 'policy'}"]
    names = ("eval_episodes", option.partition("=")[0])
    line = refused(
        capsys,
        recipe,
        *but(tuple(given), *names),
        option.format(path),
        f"out={tmp_path / 'out'}",
    )
    assert repr(path) in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("recipe", "option"),
    [
        ("sft", "eval_domains=[{}]"),
        ("rl_co", "train_domain={}"),
        ("quickstart", "train_domain={}"),
    ],
)
def test_an_effect_that_does_not_fit_is_refused_before_anything_starts(
    inputs: dict[str, list[str]],
    capsys: Capture,
    tmp_path: Path,
    recipe: str,
    option: str,
) -> None:
    file = tmp_path / "elbow.yaml"
    damping = AppliedEffect("viscous_damping", "elbow", {"damping": 1.0})
    write_effects(file, [damping])
    given = but(tuple(inputs.get(recipe, [])), "eval_episodes", "eval_domains")
    line = refused(
        capsys, recipe, *given, option.format(file), f"out={tmp_path / 'out'}"
    )
    assert "'elbow'" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("train", [True, False])
def test_two_domains_of_one_name_are_refused(
    assets: Assets, damped: Path, capsys: Capture, tmp_path: Path, train: bool
) -> None:
    other = tmp_path / damped.name
    write_effects(other, [AppliedEffect("viscous_damping", "joint4", {"damping": 1.0})])
    where = [f"eval_domains=[{damped},{other}]"]
    if train:
        where = [f"eval_domains=[{damped}]", f"train_domain={other}"]
    given = [*stage_two(assets), *but(RL_CO, "eval_domains"), *where]
    line = refused(capsys, "rl_co", *given, f"out={tmp_path / 'out'}")
    assert "'damped'" in line
    assert "rename" in line
    assert not (tmp_path / "out").exists()


def test_a_file_whose_name_is_no_column_is_refused(
    assets: Assets, damped: Path, capsys: Capture, tmp_path: Path
) -> None:
    file = tmp_path / "a,b.yaml"
    shutil.copy(damped, file)
    given = [f"policy={assets.sft / 'policy'}", f"domain={file}"]
    line = refused(capsys, "evaluate", *given, f"out={tmp_path / 'out'}")
    assert "'a,b'" in line
    assert not (tmp_path / "out").exists()


# -- Runs of before ----------------------------------------------------------------


@pytest.mark.parametrize(
    "stage", ["sft", pytest.param("rl_co", marks=pytest.mark.thorough)]
)
def test_a_run_from_before_there_were_these_options_is_resumed(
    assets: Assets, tmp_path: Path, stage: str
) -> None:
    whole, old = getattr(assets, stage), tmp_path / "old"
    shutil.copytree(whole, old)
    config = yaml.safe_load((old / "config.yaml").read_text())
    for name in ("train_domain", "effects_code"):
        config.pop(name, None)
    (old / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    (old / "checkpoints" / "step_0000003.safetensors").unlink()
    shutil.rmtree(old / "policy")
    start(stage, f"resume={old}")
    for name in ("metrics.csv", "policy/policy.safetensors", "config.yaml"):
        assert (old / name).read_bytes() == (whole / name).read_bytes(), name
