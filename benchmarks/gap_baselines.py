"""What a case looks like to a user, what is left of it, and greedy naming.

`naive` runs the plain greedy search of ``../shared/tools/naive_gap.py``, as it is.
Everybody's answer is judged alike, by `left`: whole held-out recordings, simulated
open loop by the plant's own code.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from gap_arms import Array
from gap_plant import Hidden, make_plant
from gap_recording import record
from timed_process import run_timed

NAIVE = Path(__file__).parents[2] / "shared" / "tools" / "naive_gap.py"
_LINE = re.compile(r"\| greedy (?P<effects>\[.*\]) \| left (?P<left>\S+) \|")


@dataclass(frozen=True)
class Logged:
    """A case as a user has it: a model and recordings.

    Attributes:
        xml: The model.
        fps: Frames a second [1/s].
        positions: Of each recording, (frames, joints) [rad].
        commands: The same.
    """

    xml: str
    fps: float
    positions: list[Array]
    commands: list[Array]


def read_case(folder: Path) -> Logged:
    """Read a case's model and recordings, and not its truth."""
    info = json.loads((folder / "data/meta/info.json").read_text())
    files = sorted((folder / "data/data").rglob("*.parquet"))
    table = pq.read_table(files).sort_by("index")
    episode = table["episode_index"].to_numpy()
    columns = [
        np.stack(table[name].to_numpy()).astype(float)
        for name in ("observation.state", "action")
    ]
    positions, sent = (
        [column[episode == number] for number in range(info["total_episodes"])]
        for column in columns
    )
    xml = (folder / "model.xml").read_text()
    return Logged(xml, float(info["fps"]), positions, sent)


def split(recordings: int) -> tuple[list[int], list[int]]:
    """Return which recordings are fitted, and which not: every third."""
    held = [number for number in range(recordings) if number % 3 == 2]
    return [number for number in range(recordings) if number not in held], held


def left(logged: Logged, effects: Sequence[Hidden], recordings: Sequence[int]) -> float:
    """Return the root mean square disagreement under a list of effects [rad]."""
    return float(np.sqrt(np.mean(residual(logged, effects, recordings) ** 2)))


def residual(
    logged: Logged, effects: Sequence[Hidden], recordings: Sequence[int]
) -> Array:
    """Return measured minus simulated positions, (rows,) [rad]."""
    plant, random = make_plant(logged.xml, effects), np.random.default_rng(0)
    rows = [
        logged.positions[i]
        - record(plant, logged.commands[i], logged.fps, random).position
        for i in recordings
    ]
    return np.concatenate([row.ravel() for row in rows])


def hidden_of(effects: Sequence[Mapping[str, Any]]) -> tuple[Hidden, ...]:
    """Return effects that the plant can have, from a truth's or a report's rows."""
    return tuple(
        Hidden(row["name"], row["target"], row["parameters"]) for row in effects
    )


def naive(folder: Path, seconds: float) -> dict[str, Any]:
    """Run the greedy baseline on one case folder, with a time limit."""
    command = [sys.executable, str(NAIVE), str(folder.parent), folder.name]
    done = run_timed(command, seconds)
    row = {"name": folder.name, "seconds": done.seconds, "cpu": done.cpu}
    if done.status == -9:
        return {**row, "timeout": seconds}
    match = _LINE.search(done.output)
    if match is None:
        return {**row, "failed": done.errors.strip().splitlines()[-1:]}
    effects = [
        {"name": name, "target": target}
        for name, target, _ in ast.literal_eval(match["effects"])
    ]
    return {**row, "effects": effects, "left": float(match["left"])}
