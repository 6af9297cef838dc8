"""Commands of the recordings: rich excitation, slow reaches, demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gap_arms import Arm, Array

Random = np.random.Generator
ENCODER_STEP = 2 * np.pi / 4096  # [rad], 12 bits a turn
FASTEST = 5.0  # ramps [rad/s]


@dataclass(frozen=True)
class Motion:
    """How recordings of one kind are made.

    Attributes:
        name: ``excite``, ``reach``, ``demo`` or ``hobby``.
        fps: Frames a second [1/s].
        episodes: Recordings of a case.
        frames: Frames of each.
        velocity: Whether velocities are logged.
        noise: Standard deviation of the encoders' noise [rad].
        quantum: What they round to, 0 for nothing [rad].
        jitter: By how much each number of the plant differs from the model, as a part
            of its value (standard deviation).
    """

    name: str
    fps: int
    episodes: int
    frames: int
    velocity: bool
    noise: float
    quantum: float
    jitter: float


MOTIONS = {
    "excite": Motion("excite", 50, 10, 300, True, 4e-4, 0.0, 0.0),
    "reach": Motion("reach", 50, 8, 300, False, 3e-4, ENCODER_STEP, 0.03),
    "demo": Motion("demo", 30, 10, 240, False, 3e-4, ENCODER_STEP, 0.0),
    # Reaches as LeRobot records them of a hobby arm.
    "hobby": Motion("hobby", 30, 10, 300, False, 3e-4, ENCODER_STEP, 0.03),
}


def commands(arm: Arm, motion: Motion, random: Random) -> Array:
    """Return one episode's commands, (frames, joints) [rad]."""
    time = np.arange(motion.frames) / motion.fps
    if motion.name == "excite":
        columns = [
            (_sines, _sines, _steps)[random.integers(3)](time, sweep, random)
            for sweep in arm.sweep
        ]
        return arm.home + np.stack(columns, axis=1)
    start = arm.home + random.uniform(-0.1, 0.1, len(arm.home)) * arm.sweep
    if motion.name in ("reach", "hobby"):
        moves = _moves(time, 0.75 * arm.sweep, (1.0, 2.0), (0.3, 0.8), random)
        return start + moves
    moves = _moves(time, 0.6 * arm.sweep, (1.5, 3.0), (0.3, 1.5), random)
    return start + moves + _tremble(time, len(start), random)


def _sines(time: Array, sweep: float, random: Random) -> Array:
    """Return up to four sines that start at zero, the faster the smaller."""
    total = np.zeros_like(time)
    for _ in range(random.integers(1, 5)):
        frequency = np.exp(random.uniform(np.log(0.1), np.log(1.5)))
        size = random.uniform(0.4, 1.0) / (1.0 + 1.5 * frequency)
        total += random.choice([-1, 1]) * size * np.sin(2 * np.pi * frequency * time)
    return sweep * total / max(1.0, np.abs(total).max())


def _steps(time: Array, sweep: float, random: Random) -> Array:
    """Return holds at random levels, with ramps of a tenth to half a second between."""
    knots, levels = [0.0], [0.0]
    while knots[-1] < time[-1]:
        level = sweep * random.uniform(-1.0, 1.0)
        ramp = max(random.uniform(0.1, 0.5), abs(level - levels[-1]) / FASTEST)
        knots += [knots[-1] + ramp, knots[-1] + ramp + random.uniform(0.3, 0.9)]
        levels += [level, level]
    return np.interp(time, knots, levels)


def _moves(
    time: Array,
    reach: Array,
    moves: tuple[float, float],
    holds: tuple[float, float],
    random: Random,
) -> Array:
    """Return minimum-jerk moves between random poses, with pauses, (T, joints)."""
    path, pose = np.zeros((len(time), len(reach))), np.zeros_like(reach)
    now = random.uniform(0.0, holds[1])
    while now < time[-1]:
        # Once in four, a joint stays where it is while others move.
        goal = reach * random.uniform(-1.0, 1.0, len(reach))
        change = np.where(random.random(len(reach)) < 0.75, goal - pose, 0.0)
        seconds = random.uniform(*moves)
        s = np.clip((time - now) / seconds, 0.0, 1.0)
        path += (s**3 * (10 - 15 * s + 6 * s**2))[:, None] * change
        pose = pose + change
        now += seconds + random.uniform(*holds)
    return path


def _tremble(time: Array, joints: int, random: Random) -> Array:
    """Return a hand's slow trembling of some milliradians, (T, joints) [rad]."""
    total = np.zeros((len(time), joints))
    for frequency in random.uniform(0.5, 2.0, 3):
        phase = random.uniform(0.0, 2 * np.pi, joints)
        size = random.uniform(0.5e-3, 2e-3, joints)
        total += size * np.sin(2 * np.pi * frequency * time[:, None] + phase)
    return total
