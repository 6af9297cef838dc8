"""Check effects that were found on recordings that nothing was fitted to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rlco.gap.compare.comparisons import chosen
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.check import carried_over
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.wording import amount
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Array
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model
from rlco.physics.effects import load_code
from rlco.physics.effects.apply import checked, compile_with
from rlco.physics.effects.effects_file import read_effects
from rlco.physics.effects.names import in_model


@dataclass(frozen=True)
class Check:
    """How far a model and recordings disagree, without and with effects.

    Attributes:
        channels: What is compared: joints, or the tool's coordinates, C of them.
        units: The unit of each.
        before: Root mean square disagreement of the model as it is, (C,) [unit];
            infinite where the simulation diverges.
        after: The same with the effects, (C,) [unit].
        noise: The noise of the measurements, (C,) [unit].
        notes: What was noticed and corrected in the recordings.
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    before: Array
    after: Array
    noise: Array
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return one line per channel."""
        width = max(len(name) for name in self.channels)
        rows = zip(
            self.channels, self.units, self.before, self.after, self.noise, strict=True
        )
        return [
            f"{name:{width}}: {_size(before, unit)} as it is, {_size(after, unit)} "
            f"with the effects; noise {amount(noise, unit)}"
            for name, unit, before, after, noise in rows
        ]

    def as_json(self) -> dict[str, object]:
        """Return the same for programs; None where the simulation diverges."""
        return {
            "channels": list(self.channels),
            "units": list(self.units),
            "before": _finite(self.before),
            "after": _finite(self.after),
            "noise": self.noise.tolist(),
            "notes": list(self.notes),
        }


def _size(value: float, unit: str) -> str:
    return amount(value, unit) if np.isfinite(value) else "diverging"


def _finite(values: Array) -> list[float | None]:
    """Return numbers for JSON, which has no infinity."""
    return [float(value) if np.isfinite(value) else None for value in values]


def check_effects(
    model: str | Path,
    data: str | Path,
    effects: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    angles: str | None = None,
    compare: str | None = None,
    effects_code: str | Path | None = None,
    model_root: str | Path | None = None,
    threads: int = 2,
) -> Check:
    """Compare recordings with a model as it is, and with effects; nothing is fitted.

    Args:
        model: The model without the effects, see `run_gap`.
        data: Recordings, best of another day than those the effects were found in.
        effects: The ``effects.yaml`` that a search wrote.
        rename: ``{name in the data: name in the model}``.
        scale: ``{column in the data: factor}``, see `read_log`.
        angles: ``degrees`` or ``radians``; None to infer it from their size.
        compare: ``positions`` or ``torques``; None: positions where there are commands.
        effects_code: A Python file that registers effects of your own.
        model_root: The folder in which all files lie that the model reads, see
            `run_gap`.
        threads: Number of parallel simulations.

    Raises:
        RlcoError: The model, the recordings or the effects cannot be used.

    Example:
        >>> files = "arm.xml", "new.csv", "gap_report/effects.yaml"
        >>> check_effects(*files).after  # doctest: +SKIP
        array([2.0e-05, 2.1e-05])
    """
    load_code(effects_code)
    loaded = load_model(model, root=model_root)
    # A task's controller reads the encoders of its motors.
    controlled = loaded.task is not None
    found = [
        checked(loaded.model, effect, controlled=controlled)
        for effect in in_model(read_effects(effects).renamed(), loaded.model)
    ]
    compile_with(loaded.spec, found)
    log = read_log(data, loaded, rename=rename, scale=scale, angles=angles)
    asked, _ = chosen(log, compare)
    problem = make_problem(loaded, log, threads=threads, compare=asked, cut=False)
    hypothesis = Hypothesis(tuple(found))
    if isinstance(problem, TorqueLog):
        hypothesis = carried_over(hypothesis)
    squares = problem.residuals([Hypothesis(), hypothesis]) ** 2
    channel = problem.layout.channel
    count = len(problem.layout.channels)
    before, after = (
        np.sqrt(np.bincount(channel, row, count) / np.bincount(channel, None, count))
        for row in squares
    )
    return Check(
        problem.layout.channels,
        problem.layout.units,
        before,
        after,
        np.asarray(problem.noise, dtype=float),
        problem.log.notes,
    )
