"""What the tests of the recipes share: starting one as its command line would."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rlco.run import run_recipe

RECIPES = Path(__file__).parents[2] / "recipes"

SFT = (
    "updates=6",
    "log_every=2",
    "batch_size=16",
    "hidden=[16]",
    "eval_episodes=0",
)
RL_CO = (
    "iterations=3",
    "num_envs=2",
    "epochs=1",
    "minibatch=30",
    "real_rows=8",
    "critic_iterations=1",
    "eval_every=2",
    "eval_episodes=2",
    "eval_domains=[sim]",
)


@dataclass(frozen=True)
class Assets:
    """What is recorded and trained once for all tests.

    Attributes:
        sim: Demonstrations recorded in ``sim``.
        real: Demonstrations recorded in ``stand_in``.
        sft: The run directory of a Stage I of six updates.
        rl_co: The run directory of a Stage II of three rollouts after it.
    """

    sim: Path
    real: Path
    sft: Path
    rl_co: Path


def start(recipe: str, *arguments: str) -> None:
    """Run a recipe in this process, as ``recipes/<recipe>.py ARGUMENTS`` would."""
    module: Any = importlib.import_module(recipe)
    run_recipe(module.main, module.Config, arguments)


def refused(capsys: pytest.CaptureFixture[str], recipe: str, *arguments: str) -> str:
    """Run a recipe that must refuse its input; return its one line on stderr."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        start(recipe, *arguments)
    assert caught.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    assert lines[0].endswith(".")
    return lines[0]


def edit_frames(folder: Path, change: Any) -> None:
    """Rewrite every table of frames of a data set through ``change(table)``."""
    for file in (folder / "data").rglob("*.parquet"):
        pq.write_table(change(pq.read_table(file)), file)


def with_nan(table: pa.Table) -> pa.Table:
    """Put a NaN into the action of the third frame."""
    rows = table["action"].to_pylist()
    rows[2][0] = float("nan")
    kind = table.schema.field("action").type
    index = table.schema.get_field_index("action")
    return table.set_column(index, "action", pa.array(rows, kind))


def rename_action(folder: Path) -> None:
    """Call the action ``actions``, in the tables and in what describes them."""
    edit_frames(
        folder,
        lambda table: table.rename_columns(
            ["actions" if name == "action" else name for name in table.column_names]
        ),
    )
    info = folder / "meta" / "info.json"
    content = json.loads(info.read_text())
    content["features"]["actions"] = content["features"].pop("action")
    info.write_text(json.dumps(content))


def tree(folder: Path) -> dict[str, bytes]:
    """Return every file's bytes by its path."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
