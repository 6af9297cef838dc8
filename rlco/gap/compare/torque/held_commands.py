"""Effort that was read where it jumps: once in each period in which a command is held.

A servo's torque jumps when the next command comes, by its stiffness times the step, and
falls off while the joint follows. Motion shows the mean of that, and a reading just
before or after a jump lies up to half a jump beside it, in proportion to speed: it
looks like damping that nobody has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.files import few
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects.targets import actuated_joint, is_servo

# Efforts are those of a servo where its law explains this part of their variance ...
_EXPLAINED = 0.9
# ... they were read beside their mean where that shows by so many standard errors ...
_ERRORS = 6.0
# ... and by so many times the noise of the readings.
_NOISE = 3.0
# What is measured too much falls to this part without the jumps, of which so much is in
# it, at so many joints.
_LESS = 0.5
_PART = (0.1, 1.3)
_MOST = 0.5
_AS_WELL = 1.3  # times as much left of the variance
_LATEST = 0.15  # seconds by which a command may come late
_ROWS = 20


@dataclass(frozen=True)
class Jumps:
    """How far efforts were read from their mean.

    Attributes:
        joints: The joints of which that shows.
        beside: Root mean square of that distance, (joints,) [N m].
        period: How long a command is held [s].
    """

    joints: tuple[str, ...]
    beside: Array
    period: float


def effort_jumps(problem: TorqueLog) -> Jumps | None:
    """Return at which joints effort was read where it jumps; None where nothing shows.

    Of each servo the effort is fitted, by least squares, with what it makes of the
    distance to the mean of the commands before and after the reading, of the step
    between these, and of the speed. Commands that rise smoothly and are not held give
    such a step its part, too: so it must also be what measured torques have too much.

    Args:
        problem: Torques, with the commands that were sent.
    """
    log = problem.log
    if any(r.command is None or r.rows < _ROWS for r in log.recordings):
        return None
    period = float(np.median(np.concatenate([np.diff(r.time) for r in log.recordings])))
    extra = [_extra(problem, index) for index in range(len(log.recordings))]
    found: dict[str, float] = {}
    jumping = 0
    for joint, command in servo_columns(log, problem.model):
        gain, late = _step_gain(log.recordings, joint, command, period)
        jumps = [gain * _steps(r, command, late) for r in log.recordings]
        if _size(np.concatenate(jumps)) > _NOISE * problem.noise[joint]:
            jumping += 1
            beside = _beside(extra, log.recordings, joint, jumps)
            found |= {log.joints[joint]: beside} if beside > 0.0 else {}
    # A missing effect may look like it at one joint, not at half of them.
    if not found or len(found) < _MOST * jumping:
        return None
    return Jumps(tuple(found), np.array(list(found.values())), period)


def warning(jumps: Jumps) -> str:
    """Say what such readings are worth."""
    return (
        f"Effort of {few(jumps.joints, 3)} looks as if it was read once in each "
        f"{1e3 * jumps.period:.3g} ms in which a command is held, where it jumps: up "
        f"to {jumps.beside.max():.3g} N m (root mean square) beside its mean. No "
        "effect of the robot does that, and it looks like friction or damping: take no "
        "name from these torques."
    )


def servo_columns(log: Log, model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the columns of each logged joint and of its servo's command."""
    pairs = []
    for column, name in enumerate(log.actuators):
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
        joint = actuated_joint(model, number) if number >= 0 else None
        if joint in log.joints and is_servo(model, number):
            pairs.append((log.joints.index(joint), column))
    return pairs


def _step_gain(
    parts: Sequence[Recording], joint: int, command: int, period: float
) -> tuple[float, int]:
    """Return how much of a command's step is in a joint's effort, 0 where none shows.

    Returns:
        That [N m/rad], and by how many rows commands come late.
    """
    fits = []
    for late in range(1 + min(round(_LATEST / period), _ROWS // 2)):
        rows = [_law(part, joint, command, late) for part in parts]
        causes = np.concatenate([one for one, _ in rows])
        effort = np.concatenate([other for _, other in rows])
        if effort.std() > 0.0 and causes[:, 1].std() > 0.0:
            fits.append((*_fitted(causes, effort), late))
    best = max((share for share, *_ in fits), default=0.0)
    if best < _EXPLAINED:
        return 0.0, 0
    # Of two neighbours that explain as much, the step is in the first.
    left = _AS_WELL * (1.0 - best)
    return next((gain, late) for share, gain, late in fits if 1.0 - share <= left)


def _law(part: Recording, joint: int, command: int, late: int) -> tuple[Array, Array]:
    """Return what a servo's effort is made of, (rows, 4), and the effort, (rows,)."""
    place = np.asarray(part.position)[:, joint]
    speed = (
        np.gradient(place, part.time)
        if part.velocity is None
        else part.velocity[:, joint]
    )
    sent = np.asarray(part.command)[:, command]
    after, before = sent[1 : len(sent) - late], sent[: len(sent) - late - 1]
    now = slice(1 + late, None)
    causes = [
        0.5 * (after + before) - place[now],
        after - before,
        speed[now],
        np.ones(len(after)),
    ]
    return np.stack(causes, axis=1), np.asarray(part.torque)[now, joint]


def _fitted(causes: Array, effort: Array) -> tuple[float, float]:
    """Return the explained share of variance, and the step's part in the effort."""
    sizes = np.linalg.norm(causes, axis=0)
    sizes[sizes == 0] = 1.0
    scaled = causes / sizes
    gains, *_ = np.linalg.lstsq(scaled, effort, rcond=None)
    left = effort - scaled @ gains
    share = 1.0 - float(left.var() / effort.var())
    spread = np.linalg.pinv(scaled.T @ scaled)[1, 1] * left.var()
    shows = abs(gains[1]) > _ERRORS * np.sqrt(spread)
    return share, float(gains[1] / sizes[1]) if shows else 0.0


def _steps(part: Recording, command: int, late: int) -> Array:
    """Return a command's step at each row, as late as it acts, (T,)."""
    sent = np.asarray(part.command)[:, command]
    return np.pad(np.diff(sent), (1 + late, 0))[: len(sent)]


def _extra(problem: TorqueLog, recording: int) -> tuple[Array, Array]:
    """Return times (T,), and what is measured beyond what motion takes (T, joints)."""
    trace = problem.traces(Hypothesis(), recording)
    return trace["time"], trace["measured"] - trace["simulated"]


def _beside(
    extra: Sequence[tuple[Array, Array]],
    parts: Sequence[Recording],
    joint: int,
    jumps: Sequence[Array],
) -> float:
    """Return how much of what is measured too much is the jumps; 0 where not most is.

    Of either sign: which of two commands a reading follows, its law does not tell. A
    joint that follows within a jump has half of it away before it is read.
    """
    own = np.concatenate([rows[:, joint] for _, rows in extra])
    jump = np.concatenate(
        [
            np.interp(time, part.time, one)
            for (time, _), part, one in zip(extra, parts, jumps, strict=True)
        ]
    )
    power = float(jump @ jump)
    part = float(own @ jump) / power if power > 0 else 0.0
    if not _PART[0] < abs(part) < _PART[1]:
        return 0.0
    most = _size(own - part * jump) < _LESS * _size(own)
    return abs(part) * _size(jump) if most else 0.0


def _size(rows: Array) -> float:
    return float(np.sqrt(np.mean(rows**2)))
