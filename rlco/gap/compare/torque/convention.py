"""Detect the convention of logged torques: sign, unit, and inclusion of gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from rlco.errors import DataError
from rlco.files import few
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.held_commands import effort_jumps
from rlco.gap.compare.torque.torque_log import SIGN_SPEED, TorqueLog
from rlco.gap.logs.log import Array, Log
from rlco.gap.logs.runaway import runaway

_SURE = 0.8  # correlation from which a unit is inferred
_CLEARLY = 0.6  # largest ratio of residuals at which the other sign is preferred
_TIMES = 3.0  # a factor shared by several joints that no missing effect explains
_ALONE = 10.0  # the same for one joint or for differing factors: a load may be heavy
_ALIKE = 1.6  # factors of one unit differ by less
_UNITS = {"N mm": 1000.0, "N cm": 100.0}
_MOVES = 0.05  # of a joint, in which a measured torque changes [rad or m]
_HEAVY = 0.1  # share of a joint's torque from which gravity decides the sign


@dataclass(frozen=True)
class _Rows:
    """All rows of a log, (rows, joints) each."""

    measured: Array
    computed: Array
    gravity: Array
    position: Array
    velocity: Array


def torque_problem(spec: mujoco.MjSpec, log: Log) -> TorqueLog:
    """Return the torque problem of a log, its conventions matched to the model's.

    Columns with the opposite sign, and torques in N mm or N cm, are converted, with a
    note. Each joint's sign is inferred with the model's inertia and weight as they are,
    plus free friction and damping terms, which dissipate energy under either sign. No
    sign is inferred from effort that was read where it jumps.

    Args:
        spec: The model.
        log: Positions and torques.

    Raises:
        DataError: If torques leave gravity out, their unit is unknown, or that of a
            joint never changes while it moves.
    """
    _refuse_constant(log)
    problem = TorqueLog(spec, log)
    sizes = [float(np.abs(np.asarray(r.torque)).max()) for r in log.recordings]
    far = runaway(sizes)
    rows = _rows(problem, np.flatnonzero(~far).tolist())
    unit, factor = _unit(problem, rows)
    factors = np.ones(len(log.joints))
    notes = [
        f"Torques of {log.recordings[i].name!r} reach {sizes[i]:.3g}, far beyond all "
        "other recordings: units and signs were judged without it."
        for i in np.flatnonzero(far).tolist()
    ]
    if factor != 1.0:
        factors[np.array(problem.layout.units) == "N m"] = 1.0 / factor
        notes.append(f"Torques are in {unit}, and were converted.")
    rows = replace(rows, measured=rows.measured * factors)
    flipped = _flipped(rows)
    if flipped.any() and effort_jumps(problem) is not None:
        # Jumps look like damping that drives: of a light joint they outweigh the rest.
        flipped[:] = False
    if flipped.any():
        factors[flipped] *= -1.0
        rows = replace(rows, measured=rows.measured * np.where(flipped, -1.0, 1.0))
        named = [repr(n) for n, f in zip(log.joints, flipped, strict=True) if f]
        notes.append(
            f"Torques of {few(named, len(named))} have the opposite sign to the "
            "model's and were negated; if the log is right, flip the model's axis."
        )
    _refuse_without_gravity(rows)
    if not notes:
        return problem
    return TorqueLog(spec, with_factors(log, factors, notes))


def with_factors(log: Log, factors: Array, notes: Sequence[str] = ()) -> Log:
    """Return a log with the torques of each joint times a factor, (joints,)."""
    recordings = [
        replace(one, torque=np.asarray(one.torque) * factors) for one in log.recordings
    ]
    return replace(log, recordings=tuple(recordings), notes=(*log.notes, *notes))


def factors_between(log: Log, converted: Log) -> Array:
    """Return the factor of each joint's torques between a log and its converted form.

    Returns:
        (joints,); one where a joint's torque is zero throughout.
    """
    before, after = (
        np.concatenate([np.asarray(r.torque) for r in one.recordings])
        for one in (log, converted)
    )
    row = np.abs(before).argmax(axis=0), np.arange(before.shape[1])
    zero = before[row] == 0.0
    return np.where(zero, 1.0, after[row] / np.where(zero, 1.0, before[row]))


def _rows(problem: TorqueLog, recordings: Sequence[int]) -> _Rows:
    traces = [problem.traces(Hypothesis(), index) for index in recordings]
    keys = ("measured", "simulated", "torque", "position", "velocity")
    return _Rows(*(np.concatenate([trace[key] for trace in traces]) for key in keys))


def _unit(problem: TorqueLog, rows: _Rows) -> tuple[str, float]:
    """Return the unit of the hinges' torques, and how many of it are one N m.

    It is inferred from all joints whose torque correlates with the model's, in either
    sign.
    """
    factors = {}
    for column, name in enumerate(problem.log.joints):
        one, other = rows.measured[:, column], rows.computed[:, column]
        if problem.layout.units[column] != "N m" or not (one.any() and other.any()):
            continue
        if one.std() < 3.0 * problem.noise[column] or other.std() == 0.0:
            continue
        if abs(float(np.corrcoef(one, other)[0, 1])) > _SURE:
            factors[name] = float(one.std() / other.std())
    if not factors:
        return "N m", 1.0
    sizes = np.array(list(factors.values()))
    for unit, size in _UNITS.items():
        if (np.abs(np.log(sizes / size)) < np.log(_ALIKE)).all():
            return unit, size
    alike = len(sizes) > 1 and sizes.max() < _ALIKE**2 * sizes.min()
    most = _TIMES if alike else _ALONE
    if sizes.min() < most and sizes.max() > 1.0 / most:
        return "N m", 1.0
    ratios = [
        f"{factor:.3g} times the model's at {n!r}" for n, factor in factors.items()
    ]
    raise DataError(
        f"the log's torques are {few(ratios)}; give them in N m at the joint, after "
        "the gear."
    )


def _flipped(rows: _Rows) -> NDArray[np.bool_]:
    """Return which joints' torques have the opposite sign, (joints,)."""
    ratios = np.array([_ratio(rows, joint) for joint in range(rows.measured.shape[1])])
    other, own = ratios < _CLEARLY, ratios > 1.0 / _CLEARLY
    # A robot has one sign: if all joints that reveal it are flipped, so are the others.
    all_flipped = other.sum() >= min(2, len(ratios)) and not own.any()
    return np.full(len(ratios), True) if all_flipped else other


def _ratio(rows: _Rows, joint: int) -> float:
    """Return a joint's residual with the opposite sign over that with its own."""
    measured, computed = rows.measured[:, joint], rows.computed[:, joint]
    speed, position = rows.velocity[:, joint], rows.position[:, joint]
    braking = [np.tanh(speed / SIGN_SPEED), speed]
    if rows.gravity[:, joint].std() < _HEAVY * computed.std():
        # Only inertia reveals the sign here, and a spring may outweigh it.
        braking.append(position - position.mean())
    level = np.ones_like(speed)

    def residual(sign: float) -> float:
        columns = [sign * one for one in braking] + [level, -level]
        return float(nnls(np.stack(columns, axis=1), measured - sign * computed)[1])

    own = residual(1.0)
    return residual(-1.0) / own if own > 0.0 else np.inf


def _refuse_constant(log: Log) -> None:
    """Raise where a torque stays the same while its joint moves: nobody measured it."""
    changes, moves = (
        np.max([np.ptp(np.asarray(one), axis=0) for one in parts], axis=0)
        for parts in zip(*((r.torque, r.position) for r in log.recordings), strict=True)
    )
    constant = (changes == 0.0) & (moves > _MOVES)
    if constant.any():
        names = [n for n, same in zip(log.joints, constant, strict=True) if same]
        one = len(names) == 1
        what = "moves and its torque" if one else "move and their torques"
        raise DataError(
            f"{few(names)} {what} never change{'s'[:one]}, as in columns that nothing "
            f"fills; leave {'the joint' if one else 'these joints'} out "
            f"(rename={names[0]}:-), or give torques that were measured."
        )


def _refuse_without_gravity(rows: _Rows) -> None:
    without = rows.computed - rows.gravity
    near = _size(rows.measured - without) < 0.5 * _size(rows.measured - rows.computed)
    if near and _size(rows.measured) * _TIMES > _size(without):
        raise DataError(
            "the measured torques match those of the model without gravity; give "
            'torques that include gravity, or a model with gravcomp="1".'
        )


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
