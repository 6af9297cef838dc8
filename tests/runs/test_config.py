"""Options: what lies over what, and every wrong input named."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from rlco.errors import ConfigError
from rlco.files import shown
from rlco.runs.config import (
    REQUIRED,
    RunOptions,
    distinct,
    option,
    parse,
    to_plain,
    to_yaml,
)


@dataclass
class PPO:
    """Options of a group."""

    lr: float = option(3e-4, "learning rate", minimum=0.0)
    epochs: int = option(4, "passes over a rollout", minimum=1, maximum=64)


@dataclass
class Config(RunOptions):
    """Options of a recipe that trains."""

    task: Literal["push_cube", "open_drawer"] = option("push_cube", "the task")
    data: str = option(REQUIRED, "folder of demonstrations")
    sizes: list[int] = option([64, 64], "widths of the layers", minimum=1)
    note: str | None = option(None, "free text")
    compiled: bool = option(False, "compile the loss")
    betas: list[float] = option([0.9, 0.99], "decay of moments")
    norm: float = option(1.0, "clip; inf: none", minimum=0, infinite=True)
    ppo: PPO = field(default_factory=PPO)


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / "debug.yaml").write_text(
        "data: small\nppo:\n  lr: 1e-2\n  epochs: 2\n"
    )
    (tmp_path / "long.yaml").write_text("data: large\n")
    return tmp_path / "train.py"


def problems(recipe: Path, *argv: str) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        parse(Config, argv, recipe)
    return caught.value.problems


def test_command_line_lies_over_yaml_over_defaults(recipe: Path) -> None:
    config = parse(Config, ["ppo.epochs=3", "config=debug"], recipe)
    # default      YAML                     command line
    assert (config.seed, config.ppo.lr, config.ppo.epochs) == (0, 0.01, 3)
    assert isinstance(config, Config)


def test_config_is_a_name_beside_the_recipe_or_a_path(recipe: Path) -> None:
    assert parse(Config, ["config=long"], recipe).data == "large"
    path = recipe.parent / "train" / "debug.yaml"
    assert parse(Config, [f"config={path}"], recipe).data == "small"


def test_all_problems_come_at_once_and_name_what_is_allowed(recipe: Path) -> None:
    found = problems(
        recipe,
        "sed=1",
        "lr=1",
        "task=push_cub",
        "ppo.epochs=1.5",
        "ppo.lr=-1",
        "sizes=[64,0]",
        "compiled=2",
        "ppo=3",
    )
    expected = [
        "unknown option 'sed' (did you mean 'seed'?); 'help' lists them all",
        "unknown option 'lr' (did you mean 'ppo.lr'?); 'help' lists them all",
        "option task: 'push_cub' is not one of 'push_cube', 'open_drawer' "
        "(did you mean 'push_cube'?)",
        "option ppo.epochs: 1.5 is not of type int",
        "option ppo.lr: -1.0 is below the least allowed, 0.0",
        "option sizes: 0 is below the least allowed, 1",
        "option compiled: 2 is not of type bool",
        "option ppo is a group; give one of ppo.lr, ppo.epochs",
        "option data is required: folder of demonstrations",
    ]
    assert found == tuple(expected)


@pytest.mark.parametrize(
    ("argument", "problem"),
    [
        ("fast", "argument 'fast' is not key=value"),
        ("--seed=3", "argument '--seed=3' is not key=value; write seed=3"),
        ("seed=1 seed=1", "option seed is given twice"),
        ("seed=[1", "option seed: '[1' is not a YAML value"),
        ("seed=null", "option seed: None is not of type int"),
        ("ppo.lr=nan", "option ppo.lr: nan is not a number"),
        ("ppo.lr=inf", "option ppo.lr: inf is not a finite number"),
        ("ppo.lr=1e999", "option ppo.lr: inf is not a finite number"),
        ("betas=[0,-.inf]", "option betas: -inf is not a finite number"),
        ("norm=-inf", "option norm: -inf is below the least allowed, 0"),
        ("ppo.epochs=65", "option ppo.epochs: 65 is above the greatest allowed, 64"),
        ("seed=" + 5000 * "1", f"option seed: {shown(5000 * '1')} is not a YAML value"),
        (
            f"sizes=[{2**63}]",
            "option sizes: 9223372036854775808 is beyond the largest number allowed, "
            "9223372036854775807",
        ),
        (
            "data=a\0b",
            r"option data: 'a\x00b' holds a NUL, which no name of a file may",
        ),
        ("data=${dta}", "option data: '${dta}' refers to an option that is not set"),
        (
            "config=debg",
            "unknown config 'debg' (did you mean 'debug'?); known: debug, long",
        ),
    ],
)
def test_wrong_argument_is_named(recipe: Path, argument: str, problem: str) -> None:
    given = [] if argument.startswith(("data=", "config=")) else ["data=x"]
    assert problems(recipe, *given, *argument.split()) == (problem,)


def test_a_path_may_begin_at_home(
    recipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    file = recipe.with_suffix("") / "home.yaml"
    file.write_text("data: ~/demos\n")
    assert parse(Config, ["data=~/demos"], recipe).data == "/home/ada/demos"
    assert parse(Config, [f"config={file}"], recipe).data == "/home/ada/demos"
    assert parse(Config, ["data=x~/demos"], recipe).data == "x~/demos"


def test_an_option_may_be_declared_to_take_infinity(recipe: Path) -> None:
    assert parse(Config, ["data=x", "norm=inf"], recipe).norm == float("inf")


def test_problem_in_a_yaml_file_names_the_file(recipe: Path) -> None:
    path = recipe.parent / "mine.yaml"
    path.write_text("data: x\nppo:\n  lrr: 1\nppo.lr: 2\nppo.lr: 3\n")
    (problem,) = problems(recipe, f"config={path}")
    assert str(path) in problem
    assert "is given twice in line" in problem
    path.write_text("data: x\nppo:\n  lrr: 1\n")
    (problem,) = problems(recipe, f"config={path}")
    assert problem.startswith(
        f"in {path}: unknown option 'ppo.lrr' (did you mean 'ppo.lr'?)"
    )
    path.write_text("- data\n")
    assert problems(recipe, f"config={path}") == (f"{path} must hold key: value lines",)


@dataclass
class Named(Config):
    """Options with a list of texts."""

    names: list[str] = option(["sim"], "names of something", check=distinct)
    grid: list[list[int]] = option([[1]], "rows of numbers")


@pytest.mark.parametrize(
    "value", ["[[a]]", "[a, {b: 1}]", "[[]]", "{a: b}", "null", "[null]"]
)
def test_a_list_of_texts_holds_texts(recipe: Path, value: str) -> None:
    path = recipe.parent / "mine.yaml"
    path.write_text(f"data: x\nnames: {value}\n")
    with pytest.raises(ConfigError, match=r"names: .* is not of type list\[str\]"):
        parse(Named, [f"config={path}"], recipe)
    path.write_text("data: x\nnames: [a, '${data}']\ngrid: [[1, 2], [3]]\n")
    config = parse(Named, [f"config={path}"], recipe)
    assert (config.names, config.grid) == (["a", "x"], [[1, 2], [3]])


@pytest.mark.parametrize("key", ["seed", "keep_checkpoints", "ppo.lr", "betas"])
def test_a_number_of_hundreds_of_digits_is_refused(recipe: Path, key: str) -> None:
    value = f"{10**400}"
    given = f"{key}=[{value}]" if key == "betas" else f"{key}={value}"
    (problem,) = problems(recipe, "data=x", given)
    assert problem.startswith(f"option {key}: ")
    assert len(problem) < 300


def test_text_stays_text_whatever_it_looks_like(recipe: Path) -> None:
    config = parse(Config, ["data=007", "note=null", "name=a=b: [c"], recipe)
    assert (config.data, config.note, config.name) == ("007", None, "a=b: [c")


def test_help_lists_every_option_and_ends_well(
    recipe: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    for word in ("help", "--help", "-h"):
        with pytest.raises(SystemExit) as ended:
            parse(Config, ["nonsense", word], recipe)
        assert ended.value.code == 0
        lines = [line.split() for line in capsys.readouterr().out.splitlines()]
        assert ["configs:", "debug,", "long"] in lines
        epochs = "ppo.epochs int 4 passes over a rollout (at least 1, at most 64)"
        assert epochs.split() in lines
        data = "data str required folder of demonstrations"
        assert data.split() in lines


def test_written_configuration_reads_back_equal(recipe: Path) -> None:
    config = parse(Config, ["data=x", "ppo.lr=1e-5", "sizes=[3]", "note=1"], recipe)
    path = recipe.parent / "saved.yaml"
    path.write_text(to_yaml(config))
    assert parse(Config, [f"config={path}"], recipe) == config


def test_lists_are_not_shared_between_configurations() -> None:
    Config().sizes.append(1)
    assert Config().sizes == [64, 64]


def test_resume_takes_the_runs_options_and_lets_only_some_change(
    recipe: Path, tmp_path: Path
) -> None:
    saved = parse(Config, ["data=x", "seed=4"], recipe)
    (tmp_path / "config.yaml").write_text(to_yaml(saved, leave_out=("out", "resume")))
    resume = f"resume={tmp_path}"
    config = parse(Config, [resume, "threads=2", "data=x"], recipe)
    assert (config.seed, config.threads) == (4, 2)
    assert problems(recipe, resume, "seed=5", "data=y") == (
        "option seed cannot change on resume: the run has 4, given was 5",
        "option data cannot change on resume: the run has 'x', given was 'y'",
    )
    assert problems(recipe, resume, "out=z") == (
        "out= and resume= cannot be given together",
    )


@dataclass
class Later(Config):
    """The recipe's options, some versions later."""

    careful: bool = option(True, "as it is done now", earlier=False)
    margin: float = option(0.5, "of something that was there before")


def test_a_run_goes_on_as_it_did_before_an_option_existed(
    recipe: Path, tmp_path: Path
) -> None:
    saved = parse(Config, ["data=x", "seed=4"], recipe)
    (tmp_path / "config.yaml").write_text(to_yaml(saved, leave_out=("out", "resume")))
    resumed = parse(Later, [f"resume={tmp_path}"], recipe)
    assert (resumed.careful, resumed.margin, resumed.seed) == (False, 0.5, 4)
    with pytest.raises(ConfigError, match="careful cannot change on resume"):
        parse(Later, [f"resume={tmp_path}", "careful=true"], recipe)
    # A run that knows the option keeps what it was started with, and a new one, and
    # one from a YAML file, does as is done now.
    (tmp_path / "config.yaml").write_text("data: x\ncareful: true\n")
    assert parse(Later, [f"resume={tmp_path}"], recipe).careful
    assert parse(Later, ["config=debug"], recipe).careful


def test_resume_of_no_run_says_so(recipe: Path) -> None:
    assert problems(recipe, "resume=nowhere") == (
        "resume='nowhere' is not a run directory: it has no config.yaml; "
        "give the folder of an earlier run",
    )


def test_plain_configuration_holds_groups_as_dicts() -> None:
    assert to_plain(Config(data="x"))["ppo"] == {"lr": 3e-4, "epochs": 4}


@dataclass
class Implying(Config):
    """A recipe's options, one of which implies others."""

    task: Literal["push_cube", "open_drawer"] = option(
        "push_cube",
        "the task",
        implies={"open_drawer": {"note": "slow", "sizes": [8], "ppo.epochs": 9}},
    )


def test_what_a_value_implies_lies_below_all_that_is_given(recipe: Path) -> None:
    """By the task, the debug configuration, and the command line."""
    plain = parse(Implying, ["config=debug"], recipe)
    assert (plain.note, plain.sizes, plain.ppo.epochs) == (None, [64, 64], 2)
    given = ["config=debug", "task=open_drawer", "note=mine"]
    config = parse(Implying, given, recipe)
    assert (config.note, config.sizes, config.ppo.epochs) == ("mine", [8], 2)


def test_a_resumed_run_keeps_its_options_whatever_is_implied(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("data: x\ntask: open_drawer\n")
    config = parse(Implying, [f"resume={tmp_path}"], tmp_path / "train.py")
    assert config.sizes == [64, 64]


def test_a_file_may_say_what_holds_for_one_value_of_an_option(recipe: Path) -> None:
    path = recipe.parent / "some.yaml"
    path.write_text(
        "task=open_drawer:\n  sizes: [4]\n  ppo: {epochs: 3}\n"
        "data: x\nsizes: [16]\nppo: {epochs: 5}\n"
    )
    other = parse(Implying, [f"config={path}"], recipe)
    assert (other.sizes, other.ppo.epochs) == ([16], 5)
    config = parse(Implying, [f"config={path}", "task=open_drawer"], recipe)
    assert (config.note, config.sizes, config.ppo.epochs) == ("slow", [4], 3)
    path.write_text("data: x\ntask: open_drawer\ntask=open_drawer: {sizes: [4]}\n")
    assert parse(Config, [f"config={path}"], recipe).sizes == [4]
    path.write_text('data: x\n"sizes=[8, 16]": {task: open_drawer}\n')
    given = [f"config={path}", "sizes=[8,16]"]
    assert parse(Implying, given, recipe).task == "open_drawer"
    path.write_text('data: x\n"sizes=[8": {task: open_drawer}\n')
    (problem,) = problems(recipe, f"config={path}")
    assert "a value before a group is no YAML" in problem
    path.write_text("data: x\ntask=open_drawr: {weight: 1}\n")
    (problem,) = problems(recipe, f"config={path}")
    assert "option task: 'open_drawr' is not one of" in problem
    path.write_text("data: x\ntask=open_drawer: {weight: 1}\n")
    (problem,) = problems(recipe, f"config={path}", "task=open_drawer")
    assert "unknown option 'weight'" in problem
