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
    logged: Logged,
    effects: Sequence[Hidden],
    recordings: Sequence[int],
    parts: bool = False,
) -> Array:
    """Return measured minus simulated positions, (rows,) [rad].

    Args:
        logged: The case.
        effects: What acts.
        recordings: Which of them.
        parts: Whether a command may arrive within a step, as one that is late by a part
            of a step.
    """
    plant, random = make_plant(logged.xml, effects), np.random.default_rng(0)
    rows = []
    for i in recordings:
        sent = logged.commands[i]
        times = np.arange(len(sent)) / logged.fps if parts else None
        recorded = record(plant, sent, logged.fps, random, times=times)
        rows.append(logged.positions[i] - recorded.position)
    return np.concatenate([row.ravel() for row in rows])


def hidden_of(effects: Sequence[Mapping[str, Any]]) -> tuple[Hidden, ...]:
    """Return effects that the plant can have, from a truth's or a report's rows."""
    return tuple(
        part
        for row in effects
        for part in _as_hidden(Hidden(row["name"], row["target"], row["parameters"]))
    )


def _as_hidden(named: Hidden) -> tuple[Hidden, ...]:
    """Return a named effect as the plant's: a search's cogging is two ripples."""
    if "second_sine" not in named.parameters:
        return (named,)
    sine, cosine = named["second_sine"], named["second_cosine"]
    count, phase = named["count"], named["phase"]
    first = {"amplitude": named["amplitude"], "count": count, "phase": phase}
    second = {
        "amplitude": float(np.hypot(sine, cosine)),
        "count": 2.0 * count,
        "phase": 2.0 * phase + float(np.arctan2(cosine, sine)),
    }
    return tuple(
        Hidden("torque_ripple", named.target, wave) for wave in (first, second)
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
