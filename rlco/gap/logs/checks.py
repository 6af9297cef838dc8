"""Checks of a log as a whole; each problem is reported in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlco.errors import DataError
from rlco.files import few
from rlco.gap.logs.log import Array, Log
from rlco.gap.logs.tracking_checks import check_tracking
from rlco.gap.model import LoadedModel

#: Less data than this, over all recordings, identifies no effect [s].
FEWEST_SECONDS = 4.0
# Recommended for a screening; named in the same message.
_ENOUGH_SECONDS = 30.0
_FEWEST_ROWS = 50
# A joint may be this much outside its range: soft limits, zeros that differ [rad, m].
_SLACK = 0.1
_SLACK_SHARE = 0.1
_OUTSIDE_ROWS = 0.05
# A signal is cut off where it runs into its extreme and out of it, at this share of
# its usual speed and more than so many of the sensor's steps a row, several times ...
_SHARP = 0.3
_SHARP_STEPS = 3.5
_LONG_RUN = 3
_TIMES = 2
# ... and in so many of all rows.
_CUT_ROWS = 0.005


def check_log(log: Log, model: LoadedModel | None) -> tuple[str, ...]:
    """Refuse logs that cannot be compared, and note what is suspicious.

    Args:
        log: In SI units, its times corrected.
        model: Whose log it should be; None if there is none.

    Returns:
        Notes, one sentence each.

    Raises:
        DataError: Too little data, no joint that moves, positions far outside the
            model's joint ranges, joints that do not follow their commands, or
            positions cut off at the end of a sensor's range.
    """
    _refuse_short(log)
    if not log.joints or log.recordings[0].position is None:
        return ()
    notes = _still_joints(log)
    if model is not None:
        _refuse_other_model(log, model)
        check_tracking(log, model)
    return (*notes, *_cut_off(log, model))


def _refuse_short(log: Log) -> None:
    rows = sum(recording.rows for recording in log.recordings)
    needed = FEWEST_SECONDS if log.body is None else 0.0
    if log.seconds < needed or rows < _FEWEST_ROWS:
        raise DataError(
            f"the log holds {log.seconds:.1f} s in {rows} rows, which is too little: "
            f"record at least {FEWEST_SECONDS:g} s of motion and {_FEWEST_ROWS} rows, "
            f"better {_ENOUGH_SECONDS:g} s."
        )


def _still_joints(log: Log) -> list[str]:
    parts = [np.asarray(r.position) for r in log.recordings]
    moves = np.any([_moves(part) for part in parts], axis=0)
    if not moves.any():
        raise DataError(
            f"no joint of the log moves ({few(log.joints)}); record motion, or check "
            "that these columns are positions."
        )
    still = [name for name, moved in zip(log.joints, moves, strict=True) if not moved]
    note = f"Joints that never move are not informative: {few(still)}."
    return [note] if still else []


def _moves(position: Array) -> Array:
    """Return which joints move by more than their noise, (joints,)."""
    reach = np.ptp(position, axis=0)
    if len(position) < 8:
        return np.asarray(reach > 0)
    # The third difference of a motion is small, that of white noise 20 ** 0.5 of it.
    noise = np.diff(position, 3, axis=0).std(axis=0) / np.sqrt(20.0)
    means = np.stack([position[i : len(position) - 7 + i] for i in range(8)]).mean(0)
    return np.asarray((reach > 0) & (np.ptp(means, axis=0) > 4.0 * noise))


def _refuse_other_model(log: Log, model: LoadedModel) -> None:
    position = np.concatenate([np.asarray(r.position) for r in log.recordings])
    for column, name in enumerate(log.joints):
        joint = model.model.joint(name)
        if not model.model.jnt_limited[joint.id]:
            continue
        low, high = joint.range
        slack = _SLACK + _SLACK_SHARE * (high - low)
        values = position[:, column]
        beyond = (values < low - slack) | (values > high + slack)
        if beyond.mean() > _OUTSIDE_ROWS:
            raise DataError(
                f"positions of {name} lie between {values.min():.3g} and "
                f"{values.max():.3g}, and the range in model {model.name!r} is "
                f"{low:.3g} to {high:.3g}: the log is of another model, or its zero, "
                "sign or unit differs; give the model of this robot, or rename= where "
                "columns are swapped."
            )


def _cut_off(log: Log, model: LoadedModel | None) -> list[str]:
    """Refuse positions that a sensor cut off; note cut-off velocities and torques."""
    notes = []
    for kind in ("position", "velocity", "torque"):
        for column, name in enumerate(log.joints):
            parts = [
                values[:, column]
                for r in log.recordings
                if (values := getattr(r, kind)) is not None
            ]
            level = _cut_level(parts)
            if level is None or _at_limit(kind, name, level, model):
                continue
            finding = f"the {kind} of {name} is cut off at {level:.4g}"
            if kind == "position":
                raise DataError(
                    f"{finding}, repeatedly in the middle of a motion: its sensor "
                    "saturates; leave these recordings out, or record within its range."
                )
            notes.append(
                f"{finding[0].upper()}{finding[1:]}, where its sensor saturates."
            )
    return notes


def _at_limit(kind: str, name: str, level: float, model: LoadedModel | None) -> bool:
    """Whether a joint rests against the end of its own range."""
    if model is None or kind != "position":
        return False
    joint = model.model.joint(name)
    near = np.abs(joint.range - level) < _SLACK / 2
    return bool(model.model.jnt_limited[joint.id] and near.any())


def _cut_level(parts: Sequence[Array]) -> float | None:
    """Return the extreme at which a signal saturates; None where it does not.

    A robot that rests at its extreme slows down before and starts slowly after; at
    the end of a sensor's range the motion goes on while the reading stays constant.
    """
    if not parts:
        return None
    steps = np.abs(np.concatenate([np.diff(part) for part in parts]))
    moving = steps[steps > 0]
    if not len(moving):
        return None
    usual = float(np.percentile(moving, 75))
    step = max(_SHARP * usual, _SHARP_STEPS * float(moving.min()))
    for level in (max(p.max() for p in parts), min(p.min() for p in parts)):
        runs = [run for part in parts for run in _sharp_runs(part, level, step)]
        if len(runs) >= _TIMES and sum(runs) >= _CUT_ROWS * sum(map(len, parts)):
            return float(level)
    return None


def _sharp_runs(values: Array, level: float, step: float) -> list[int]:
    """Return for how many rows each time a signal runs into a level and out of it."""
    at = np.r_[False, values == level, False].astype(int)
    starts, ends = np.flatnonzero(np.diff(at) == 1), np.flatnonzero(np.diff(at) == -1)
    runs = []
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        inside = first > 1 and last < len(values) - 1
        if inside and last - first >= _LONG_RUN:
            # The row at either end may be anywhere on its way; the one beyond is not.
            came = values[first - 1] - values[first - 2]
            left = values[last] - values[last + 1]
            toward = np.sign(level - values[first - 1])
            if min(came * toward, left * toward) > step:
                runs.append(last - first)
    return runs
