"""Every command that the documentation shows runs, with less of everything.

Commands that with less of everything are the same, as those that differ in a number of
updates, run once: in the longest block, as what follows there goes on with what it
wrote. Some are run by other tests, which then say what comes of them.
"""

from __future__ import annotations

import functools
import importlib
import itertools
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from arm_cases import write_arm
from bench_runs import write_bench
from commands import ROOT, Command, all_blocks
from lift_cases import LIFT, write_lift
from pages import write_results
from recipe_cases import RL_CO, SFT, start

import rlco.gap
from rlco import cli
from rlco.physics.effects import EFFECTS
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.runs.config import parse

pytestmark = pytest.mark.slow

# Overrides the page's numbers: whether it runs, not what it learns.
LESS: dict[str, dict[str, object]] = {
    "record_demos": {"episodes": 2},
    "sft": {"updates": 2, "log_every": 2, "batch_size": 16, "eval_episodes": 1},
    "rl_co": {
        **{"iterations": 2, "num_envs": 2, "horizon": 16, "epochs": 1, "minibatch": 8},
        **{"real_rows": 8, "critic_iterations": 1, "eval_every": 2, "eval_episodes": 1},
    },
    "evaluate": {"episodes": 2},
    "check_expert": {"episodes": 2},
    "align": {"updates": 2},
    "quickstart": {
        **{"sim_demos": 1, "real_demos": 1, "heldout_demos": 1, "updates": 2},
        **{"iterations": 1, "num_envs": 2, "eval_every": 1, "curve_episodes": 2},
        **{"eval_episodes": 2, "film": "false"},
    },
    "find_gap": {"film": "false"},
    "compare": {"hours": 0},
    "compare_results": {},
    "record_logs": {"recordings": 2, "seconds": 4.0},
    "close_loop": {
        **{"seeds": "[0]", "recordings": 2, "seconds": 4.0, "demos": 2},
        **{"updates": 4, "eval_episodes": 2},
    },
    "lerobot_co_train": {
        **{"iterations": 1, "num_envs": 2, "horizon": 16, "epochs": 1, "minibatch": 4},
        **{"real_rows": 2, "accumulate": 2, "eval_every": 1, "eval_episodes": 2},
    },
}
# Where a page leaves it open; a test of the quickstart has all of them.
OPEN = {"quickstart": {"methods": "[rl_co]", "eval_domains": "[sim]"}}
# Run by a test that also looks at what comes of it (some with `-m thorough` alone): the
# quickstart with as little, the search of all effects, on the model and the first
# seconds of logs of docs/example.
RUN_BY = {
    "quickstart.py": "recipes/test_chain.py",
    "quickstart.py image=dense": "recipes/test_images.py",
    "close_loop.py": "recipes/test_close_loop.py",
    "find_gap.py model=docs/example/arm.xml data=docs/example/logs": "test_cli.py",
    "find_gap.py model=arm.xml data=logs": "test_cli.py",
    **dict.fromkeys(
        (
            "rl_co.py policy=outputs/sft/RUN/policy real_demos=demos/stand_in "
            "launch=ray workers=2",
            "compare.py experiment=grid.yaml launch=ray ray_address=auto jobs=64",
        ),
        "recipes/test_rl_co_launch.py",
    ),
    "compare_results.py a=outputs/A b=outputs/B": "recipes/test_compare_results.py",
    "find_gap.py model=arm.xml reference=before data=after": "gap/test_reference.py",
    "find_gap.py model=arm.xml data=logs calibrate=usual": "gap/test_reference.py",
    "find_gap.py model=hobby_arm/arm.xml data=hobby_arm/recordings angles=degrees "
    "rename=gripper:-": "docs/test_so101_page.py",
}
# Blocks whose commands other tests run with other options: with `-m thorough` alone.
THOROUGH = (
    "uv run recipes/quickstart.py policy=token",
    "uv run recipes/record_demos.py out=demos/sim episodes=200 image_size=64",
    "uv run recipes/record_demos.py out=demos/sim128",
    "uv run recipes/sft.py task=robosuite:Lift",
    "uv run recipes/rl_co.py resume=outputs/mine",
    "uv run recipes/find_gap.py model=robosuite:push_cube",
    "uv run recipes/find_gap.py model=arm.xml data=logs out=report",
    "uv run recipes/record_demos.py domain=sim episodes=40 out=demos/sim",
    "uv run recipes/quickstart.py 'methods=[sft,rl_co]'",
    "uv run recipes/rl_co.py policy=... real_demos=... advantage=mc",
    "uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_demos=demos/robot",
    "uv run recipes/rl_co.py policy=... real_demos=... train_domain=gap_report/",
    "uv run recipes/lerobot_co_train.py policy=CHECKPOINT real_demos=demos/real",
    "PYTHONPATH=. uv run recipes/rl_co.py train_domain=my_domains:slippery",
    "uv run recipes/sft.py real_demos=demos/stand_in sim_ratio=0",
    "uv run recipes/record_demos.py task=open_drawer",
    "uv run recipes/record_demos.py out=demos/sim camera=agentview",
    "uv run recipes/sft.py sim_demos=demos/sim real_demos=demos/stand_in domain_flag",
    "uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_coeff=0",
    "uv run recipes/compare.py experiment=benchmarks/experiments/paper.yaml",
    "uv run recipes/record_logs.py domain=stand_in",
    "uv run recipes/check_expert.py task=push_cube",
    "uv run recipes/align.py",
    "PYTHONPATH=. uv run recipes/sft.py task=my_task:TASK",
    "PYTHONPATH=. uv run recipes/rl_co.py task=my_task:TASK",
)
# What a page cannot run here: it needs a network, a robot, hours, or is run elsewhere.
ELSEWHERE = {
    "uv run pytest": "this",
    "uv run lint-imports": ".ci/run",
    "bash .ci/run": ".ci/run",
    "uv sync": ".ci/run",
    "uv run ruff format": ".ci/run",
    "uv run --group docs sphinx-build -W docs docs/_build": "a network's packages",
    "uv build --wheel": "tests/test_cli.py",
    "uv run python docs/hobby_arm.py": "tests/docs/test_so101_page.py",
    "uv run tensorboard --logdir outputs": "a server",
    "uv run scripts/": "a network, or figures",
    "uv run torchrun ": "tests/recipes/test_rl_co_launch.py",
    "uv run ray ": "several machines",
    "uv run benchmarks/": "hours; tests/benchmarks",
    "pip ": "a network",
    "unzip ": "what a network gave",
    "git clone ": "a network",
    "lerobot-replay ": "a robot",
    "lerobot-rollout ": "a robot",
    "lerobot-eval ": "tests/plugins",
    "lerobot-train ": "tests/plugins",
    "lerobot-edit-dataset ": "tests/plugins",
}
PLACEHOLDERS = {"uv run recipes/NAME.py", "rlco NAME"}


def distinct_blocks() -> list[list[Command]]:
    """Return blocks with a recipe's command, each once, without what runs elsewhere.

    The tutorial's are one block: each goes on with what the one before it wrote.
    """
    found: dict[tuple[str, ...], list[Command]] = {}
    tutorial = [one for one in all_blocks() if one[0].page == TUTORIAL]
    others = [one for one in all_blocks() if one[0].page != TUTORIAL]
    for block in [*others, list(itertools.chain(*tutorial))]:
        shown = [one for one in block if one.recipe or one.words[0] == "rlco"]
        shown = [one for one in shown if one.text not in PLACEHOLDERS]
        if shown:
            found.setdefault(tuple(one.text for one in shown), shown)
    return list(found.values())


Effective = tuple[str, frozenset[str]]


def effective(command: Command) -> Effective:
    """Return what is asked for, wherever it reads and writes, without a default."""
    if command.recipe is None:
        return command.text, frozenset()
    options = with_less(command.recipe, command.options)
    plain = ("out=", "seed=", "task=push_cube")
    place = re.compile(
        r"=(?:demos/|outputs/|RUN/|CHECKPOINT|docs/example/|benchmarks/|\.\.\.).*"
    )
    kept = (place.sub("=PLACE", one) for one in options if not one.startswith(plain))
    return command.recipe, frozenset(kept)


def blocks_to_run() -> list[list[Command]]:
    """Return the distinct blocks, less what a longer one or another test runs."""
    elsewhere = {effective(Command("", f"uv run recipes/{one}")) for one in RUN_BY}
    done = set(elsewhere)
    left = []
    for block in sorted(distinct_blocks(), key=len, reverse=True):
        # In a chain each goes on with the one before, whatever shorter blocks have.
        chain = len(block) > 4
        new = [
            one for one in block if effective(one) not in (elsewhere if chain else done)
        ]
        done |= {effective(one) for one in new}
        needed = [one for one in block if one in new or any(feeds(one, n) for n in new)]
        left += [needed] if new else []
    return left


def feeds(one: Command, other: Command) -> bool:
    """Return whether another command of its block reads the folder that it writes."""
    written = [word[4:] for word in one.words if word.startswith("out=")]
    read = {word.split("=", 1)[1] for word in other.words if "=" in word}
    return one is not other and any(folder in read for folder in written)


def test_what_another_test_runs_is_on_a_page_and_that_test_is_there() -> None:
    shown = {effective(one) for block in distinct_blocks() for one in block}
    for command, tests in RUN_BY.items():
        assert effective(Command("", f"uv run recipes/{command}")) in shown
        recipe = command.split(".py")[0]
        assert f'"{recipe}"' in (ROOT / "tests" / tests).read_text()


def test_what_is_left_to_thorough_runs_is_on_a_page() -> None:
    names = [block[0].text for block in blocks_to_run()]
    assert all(any(one.startswith(left) for one in names) for left in THOROUGH)


def test_every_other_command_is_run_somewhere() -> None:
    run = {one.text for block in distinct_blocks() for one in block} | PLACEHOLDERS
    others = [o for block in all_blocks() for o in block if o.text not in run]
    plain = {" ".join(one.words) for one in others}
    assert {t for t in plain if not t.startswith(tuple(ELSEWHERE))} == {"uv run"}


def test_an_experiment_is_there_and_its_cells_are_where_its_tables_come_from() -> None:
    """The first of these commands runs; tables of all of them have their own test."""
    read = write_results().CELLS
    shown = [one for one in itertools.chain(*all_blocks()) if one.recipe == "compare"]
    given = [dict(word.split("=", 1) for word in one.options) for one in shown]
    ours = [one for one in given if one["experiment"].startswith("benchmarks/")]
    assert len([one for one in ours if "cells" in one]) > 10
    for one in ours:
        path = ROOT / one["experiment"]
        assert path.is_file(), path
        folder = f"benchmarks/cells/{read.get(path.stem, path.stem)}"
        assert one.get("cells", folder) == folder


def test_a_recipe_takes_the_options_that_a_page_gives_it() -> None:
    for command in itertools.chain(*distinct_blocks()):
        if command.recipe is None or command.options == ["help"]:
            continue
        recipe = importlib.import_module(command.recipe)
        given = [one for one in command.options if not one.startswith("resume=")]
        if len(given) < len(command.options):  # the others are those of that run
            given.append("policy=RUN/policy")
        parse(recipe.Config, given, ROOT / "recipes" / f"{command.recipe}.py")


def test_what_a_shell_would_expand_is_quoted() -> None:
    """In zsh an unquoted ``[sim]`` is a pattern, and no file matches it."""
    for command in itertools.chain(*all_blocks()):
        bare = re.sub(r"'[^']*'|\"[^\"]*\"", "", command.text)
        assert not set(bare) & set("[]{}*?"), command


TUTORIAL = "docs/tutorial.md"
EFFECTS_YAML = """
version: 1
effects:
- {name: command_delay, target: null, parameters: {delay: 0.05}}
"""
Folders = Callable[[str, str, str], Path]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """Give what an option names and its page takes for granted, made once."""
    root = tmp_path_factory.mktemp("given")

    @functools.cache
    def demos(task: str) -> Path:
        folder = root / task.replace(":", "_") / "demos"
        if task == LIFT:
            return write_lift(folder)
        more = ("camera=agentview", "image_size=64", "episodes=2")
        start("record_demos", f"task={task}", f"out={folder}", *more)
        return folder

    @functools.cache
    def stage_one(task: str) -> Path:
        given = (f"task={task}", f"real_demos={demos(task)}", "sim_ratio=0", *SFT)
        start("sft", *given, f"out={demos(task).parent / 'sft'}")
        return demos(task).parent / "sft"

    @functools.cache
    def stage_two(task: str) -> Path:
        policy = stage_one(task) / "policy"
        given = (f"task={task}", f"policy={policy}", f"real_demos={demos(task)}")
        start("rl_co", *given, *RL_CO, f"out={policy.parents[1] / 'rl_co'}")
        return policy.parents[1] / "rl_co"

    @functools.cache
    def checkpoint() -> Path:
        return write_tiny_smolvla(root / "tiny", camera="observation.images.agentview")

    @functools.cache
    def arm() -> Path:
        return write_arm(root / "arm", episodes=50, frames=6, camera="front")

    def folder(option: str, value: str, task: str) -> Path:
        if task == "null":
            return arm()
        if option == "resume":
            return stage_two(task)
        if value.startswith("CHECKPOINT") or value.endswith("pretrained_model"):
            return checkpoint()
        if option == "policy":
            return (stage_two if "rl_co" in value else stage_one)(task) / "policy"
        return demos(task)

    return folder


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with what the pages call a user's own files."""
    for name in ("docs", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "my_task.py").write_text(
        "from rlco.physics.tasks.push_cube import TASK\n"
    )
    (tmp_path / "my_domains.py").write_text(
        "from rlco.physics.spec.domain import STAND_IN as slippery\n"
    )
    page = (ROOT / TUTORIAL).read_text()
    (tmp_path / "robot.yaml").write_text(
        re.findall(r"```yaml\n(.*?)```", page, re.S)[0]
    )
    monkeypatch.chdir(tmp_path)
    for folder in (tmp_path, ROOT / "docs"):  # PYTHONPATH=. and PYTHONPATH=docs
        monkeypatch.syspath_prepend(str(folder))
    yield tmp_path
    EFFECTS.pop("quadratic_drag", None)  # of docs/my_effect.py


def filled(option: str, command: Command, folders: Folders) -> str:
    """Put a real file for what the page leaves open, and give the option."""
    name, _, value = option.partition("=")
    task = next((o[5:] for o in command.options if o.startswith("task=")), "push_cube")
    given = functools.partial(folders, name, value, task)
    found = Path("gap_report/effects.yaml")
    if str(found) in value and not found.exists():
        found.parent.mkdir()
        found.write_text(EFFECTS_YAML)
    read = command.recipe == "find_gap" and value in ("arm.xml", "logs")
    if read and not Path(value).exists():
        copy_shortened(ROOT / "docs" / "example" / value, Path(value))
    if value == "new.csv":
        shutil.copyfile(sorted((ROOT / "docs/example/logs").iterdir())[0], value)
    if value == "bam_logs":
        write_bench(Path(value))
    if name == "image_weights":
        import torch
        from torchvision.models import mobilenet_v2

        Path(value).parent.mkdir(parents=True)
        torch.save(mobilenet_v2().state_dict(), value)
    if value == "..." or "RUN" in value or value.startswith("CHECKPOINT"):
        made = sorted(Path().glob(value.replace("RUN", "*")), key=os.path.getmtime)
        return f"{name}={made[-1] if made else given()}"
    taken = value.startswith(("demos/", "outputs/")) and name != "out"
    if taken and not Path(value).exists():
        Path(value).parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(given(), value)
    return option


def copy_shortened(given: Path, copy: Path) -> None:
    """Copy a model, or the first seconds of each log."""
    if given.is_file():
        shutil.copyfile(given, copy)
        return
    copy.mkdir()
    for log in given.iterdir():
        lines = log.read_text().splitlines(keepends=True)
        (copy / log.name).write_text("".join(lines[:200]))


def run(command: Command, folders: Folders) -> int | str | None:
    """Run a command in this process as its page shows it; return its exit status."""
    try:
        if command.recipe is None:
            cli.main(command.words[1:])
        else:
            options = [filled(option, command, folders) for option in command.options]
            start(command.recipe, *with_less(command.recipe, options))
    except SystemExit as end:
        return end.code
    return 0


def with_less(recipe: str, options: list[str]) -> list[str]:
    """Return a recipe's options with small numbers for the page's, except for zeros."""
    if options == ["help"]:
        return options
    given = dict(option.split("=", 1) for option in options)
    given.pop("config", None)
    less = dict(LESS[recipe])
    if given.get("task") == "null":  # no simulator to evaluate in
        del less["eval_episodes"]
    if "group_size" in given:  # episodes of a group are of one rollout
        less["num_envs"] = given["group_size"]
    if "pretrain_scenes" in given:  # two minutes, as the page has it
        less |= {"pretrain_scenes": "16", "pretrain_passes": "1"}
    if "resume" in given:  # only the number of rollouts may change
        less = {"iterations": 4} if "iterations" in given else {}
    small = {k: v for k, v in less.items() if given.get(k) != "0"}
    asked = {**OPEN.get(recipe, {}), **given, **small}
    return [f"{name}={value}" for name, value in asked.items()]


def as_case(block: list[Command]) -> Any:
    """Return a block with its first command for its name."""
    name = block[0].text
    marks = [pytest.mark.thorough] if name.startswith(THOROUGH) else []
    return pytest.param(block, id=name, marks=marks)


@pytest.mark.parametrize("block", [as_case(block) for block in blocks_to_run()])
def test_a_block_of_commands_runs(
    block: list[Command],
    workspace: Path,
    folders: Folders,
    rendering: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A search that considers a few effects takes seconds.
    left_out = set(EFFECTS) - {"payload", "joint_offset", "command_delay"}
    few = functools.partial(rlco.gap.run_gap, exclude=left_out)
    monkeypatch.setattr(rlco.gap, "run_gap", few)
    monkeypatch.setattr("rlco.training.pretraining.HELD_OUT", 4)  # scenes to draw
    for command in block:
        assert not run(command, folders), command.text
