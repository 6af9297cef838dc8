"""Torques over a joint's position, as sums of shapes: which a residual asks for.

Each shape is a torque along the measured path of one joint, so what it does to the
positions follows from `JointResponse` without a rollout; in a log of torques it is the
change itself. Beside it the fit may use a constant, a slope, friction and damping: what
the common effects would explain does not count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.servo_response import JointResponse
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import joint_velocity
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Array
from rlco.gap.search.whitening import Whitening
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.targets import qpos_address
from rlco.physics.effects.transmission import COGGING, HARDENING_SPRING

FEWEST_WAVES = 1.0  # along a joint's path: less is a slope or a bend
MOST_COUNT = 250.0  # waves a turn; ripple of a 100:1 strain wave gear has 200
_APART = 1.0  # between tried counts: what turns a wave by so much over the path [rad]
_SHORTEST = 0.1  # path of a joint that tells a shape [rad]
_AT_ONCE = 64  # counts, for memory
_SLOW = 0.02  # speed at which friction has nearly all its size [rad/s]


@dataclass(frozen=True)
class Guess:
    """An effect with the values that a linear fit gives it.

    Attributes:
        effect: The effect.
        gain: By how much less it leaves of the sum of squares.
    """

    effect: AppliedEffect
    gain: float


class Path(Protocol):
    """The measured path of one joint, and what torques along it change."""

    @property
    def position(self) -> list[Array]:
        """By segment, (T,) each [rad]."""
        ...

    @property
    def velocity(self) -> list[Array]:
        """By segment, (T,) each [rad/s]."""
        ...

    def moved(self, torques: list[Array]) -> Array:
        """Return the change of the residuals by torques, (..., rows).

        Args:
            torques: By segment, (..., T) each [N m].
        """
        ...


@dataclass(frozen=True)
class TorquePath:
    """A `Path` in a log of torques: what acts there a drive need not supply.

    Attributes:
        position: By recording, (T,) each [rad].
        velocity: By recording, (T,) each [rad/s].
    """

    position: list[Array]
    velocity: list[Array]

    def moved(self, torques: list[Array]) -> Array:
        """Return the change of the residuals by torques, (..., rows)."""
        return np.concatenate(torques, axis=-1)


@dataclass(frozen=True)
class JointPath:
    """A `Path` in a log of commands: a joint under its servo.

    Attributes:
        response: The joint under its servo.
        step: Between the times of `position` [s].
        position: By segment, (T,) each [rad].
        velocity: By segment, (T,) each [rad/s].
        frames: Place of each compared row in its segment, (rows,) each.
    """

    response: JointResponse
    step: float
    position: list[Array]
    velocity: list[Array]
    frames: list[Array]

    def moved(self, torques: list[Array]) -> Array:
        """Return the change of the residuals by torques, (..., rows).

        Args:
            torques: By segment, (..., T) each [N m].
        """
        rows = []
        for torque, frames in zip(torques, self.frames, strict=True):
            moved = self.response.positions(torque, self.step)
            before = frames.astype(int)
            after = np.minimum(before + 1, moved.shape[-1] - 1)
            between = moved[..., after] - moved[..., before]
            # A residual is measured minus simulated.
            rows.append(-(moved[..., before] + (frames - before) * between))
        return np.concatenate(rows, axis=-1)


def path_of(
    problem: ArmRollouts | TorqueLog,
    hypothesis: Hypothesis,
    joint: str,
    recordings: Integers,
) -> Path | None:
    """Return a joint's measured path; None where it hardly moves, or has no servo.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: The joint.
        recordings: Those that are used.
    """
    if isinstance(problem, ArmRollouts):
        path = _servo_path(problem, problem.compiled(hypothesis), joint, recordings)
    else:
        path = _torque_path(problem, joint, recordings)
    if path is None:
        return None
    low, high = np.quantile(np.concatenate(path.position), (0.005, 0.995))
    return path if high - low > _SHORTEST else None


def _torque_path(problem: TorqueLog, joint: str, recordings: Integers) -> Path:
    column = problem.log.joints.index(joint)
    motions = [problem.motions[index] for index in sorted(recordings)]
    return TorquePath(
        [one.position[:, column] for one in motions],
        [one.velocity[:, column] for one in motions],
    )


def _servo_path(
    problem: ArmRollouts, model: mujoco.MjModel, joint: str, recordings: Integers
) -> Path | None:
    column = problem.log.joints.index(joint)
    segments = [one for one in problem.segments if one.recording in recordings]
    logs = [problem.log.recordings[one.recording] for one in segments]
    qpos = model.qpos0.copy()
    for number, name in enumerate(problem.log.joints):
        every = [np.asarray(log.position, dtype=float)[:, number] for log in logs]
        qpos[qpos_address(model, name)] = float(np.median(np.concatenate(every)))
    response = JointResponse.of(model, joint, qpos)
    if response is None:
        return None
    period = float(np.median(np.diff(logs[0].time)))
    step = 0.5 * period
    position, velocity, frames = [], [], []
    for segment, log in zip(segments, logs, strict=True):
        rows = slice(segment.first, segment.last + 1)
        time = np.asarray(log.time[rows], dtype=float) - float(log.time[segment.first])
        steps = step * np.arange(int(np.ceil(time[-1] / step)) + 2)
        place = np.asarray(log.position, dtype=float)[rows, column]
        speed = joint_velocity(log)[rows, column]
        position.append(np.interp(steps, time, place))
        velocity.append(np.interp(steps, time, speed))
        frames.append(time[segment.begin - segment.first :] / step)
    return JointPath(response, step, position, velocity, frames)


def guesses(
    path: Path, joint: str, rows: Integers, residual: Array, whitening: Whitening
) -> list[Guess]:
    """Return a guess at each effect whose torque depends on position, the best first.

    Args:
        path: Of the joint.
        joint: Its name.
        rows: Places of its rows in the residual, in the order of the path's segments.
        residual: Whitened, (N,).
        whitening: Of the residual.
    """
    fit = _Fit(path, rows, residual, whitening)
    found = []
    best: tuple[float, float, Array] | None = None
    counts = counts_along(path)
    for first in range(0, len(counts), _AT_ONCE):
        some = counts[first : first + _AT_ONCE]
        turned = [some[:, None] * place for place in path.position]
        waves = [np.stack([np.sin(t), np.cos(t)], axis=1) for t in turned]
        gains, amounts = fit.beyond_the_common(waves)
        at = int(gains.argmax())
        if best is None or gains[at] > best[0]:
            best = float(gains[at]), float(some[at]), amounts[at]
    if best is not None:
        gain, count, (sine, cosine) = best
        values = {
            "amplitude": float(np.hypot(sine, cosine)),
            "count": count,
            "phase": float(np.arctan2(cosine, sine)),
            "second_sine": 0.0,  # a fit finds these: they are linear
            "second_cosine": 0.0,
        }
        found.append(Guess(AppliedEffect(COGGING.name, joint, values), gain))
    bends = [np.stack([place**2, place**3])[None] for place in path.position]
    (gain,), ((square, cube),) = fit.beyond_the_common(bends)
    if cube < 0.0:
        rest = float(np.clip(-square / (3.0 * cube), -3.0, 3.0))
        spring = {"hardening": -float(cube), "rest": rest}
        effect = AppliedEffect(HARDENING_SPRING.name, joint, spring)
        found.append(Guess(effect, float(gain)))
    return sorted(found, key=lambda one: -one.gain)


def counts_along(path: Path) -> Array:
    """Return the numbers of waves a turn that are told apart along a path, (counts,).

    Example:
        >>> swing = np.sin(np.linspace(0.0, 6.28, 1000))  # 2 rad to and fro
        >>> joint = JointResponse(0.1, 4.0, 50.0)
        >>> found = counts_along(JointPath(joint, 0.01, [swing], [swing], [swing]))
        >>> round(float(found[0]), 1), round(float(found[1] - found[0]), 1)
        (3.1, 0.5)
    """
    low, high = np.quantile(np.concatenate(path.position), (0.005, 0.995))
    span = float(high - low)
    first = 2.0 * np.pi * FEWEST_WAVES / span
    return np.arange(first, MOST_COUNT, _APART / span, dtype=float)


class _Fit:
    """Linear fits of torques at one joint to a whitened residual.

    The rows of the other joints are zero in every column, so that products need no more
    than the joint's own: with a whitening W = I + B (S - I) B', c' W W d is
    c' d + (c' B) (S^2 - I) (B' d).
    """

    def __init__(
        self, path: Path, rows: Integers, residual: Array, whitening: Whitening
    ) -> None:
        self.path, self.scale = path, whitening.scale[rows]
        self.basis, self.weight = whitening.basis[rows], whitening.shrink**2 - 1.0
        along = (residual @ whitening.basis) * (whitening.shrink - 1.0)
        self.goal = residual[rows] + self.basis @ along
        signals = path.position, path.velocity
        common = [np.stack(list(row)) for row in map(_common, *signals)]
        beside = path.moved(common) / self.scale
        size = np.linalg.norm(beside, axis=1)
        self.beside = beside[size > 0.0] / size[size > 0.0, None]
        self.beside_along = self.beside @ self.basis
        gram = self._products(self.beside, self.beside_along)
        self.inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
        self.explained = self.inverse @ (self.beside @ self.goal)

    def _products(self, columns: Array, along: Array) -> Array:
        """Return whitened products of columns (..., rows) with the common ones."""
        own = columns @ self.beside.T
        return np.asarray(own + (along * self.weight) @ self.beside_along.T)

    def beyond_the_common(self, torques: list[Array]) -> tuple[Array, Array]:
        """Return gains (F,) and amounts (F, k) of F shapes with k torques each.

        Args:
            torques: By segment, (F, k, T) each.
        """
        columns = self.path.moved(torques) / self.scale
        along = columns @ self.basis
        own = np.einsum("fkr,flr->fkl", columns, columns)
        own += np.einsum("fkb,flb->fkl", along * self.weight, along)
        crossed = self._products(columns, along)
        left = own - crossed @ self.inverse @ np.swapaxes(crossed, 1, 2)
        goal = columns @ self.goal - crossed @ self.explained
        ridge = 1e-6 * np.trace(own, axis1=1, axis2=2)[:, None, None]
        left = left + ridge * np.eye(own.shape[1])
        amounts = -np.linalg.solve(left, goal[..., None])[..., 0]
        return -np.einsum("fk,fk->f", amounts, goal), amounts


def _common(position: Array, velocity: Array) -> Iterator[Array]:
    """Yield the torques of effects of the library that are common."""
    yield np.ones_like(position)
    yield position
    yield velocity
    yield np.tanh(velocity / _SLOW)
