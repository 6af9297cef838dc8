"""Excitation motions that distinguish effects, for one robot and its log.

Each motion is a sequence of joint goals at a constant rate. It stays within the ranges
and speeds in the log, starts and ends at one pose, and lasts 20 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.logs.log import Array, Log

SECONDS = 20.0
_REST = 1.0  # rest at the first and the last pose [s]


@dataclass(frozen=True)
class Workspace:
    """The robot's workspace: ranges and speeds of its joints.

    Attributes:
        joints: Names of the joints.
        low: Lowest positions, (joints,) [rad or m].
        high: Highest positions, (joints,).
        speed: Highest speeds, (joints,) [rad/s or m/s].
        home: Pose at which motions start and end, (joints,).
        rate: Rate of the goals [Hz].
    """

    joints: tuple[str, ...]
    low: Array
    high: Array
    speed: Array
    home: Array
    rate: float

    @property
    def time(self) -> Array:
        """Times of the goals [s]."""
        return np.arange(round(SECONDS * self.rate)) / self.rate


def workspace_of(model: mujoco.MjModel, log: Log) -> Workspace:
    """Return the ranges and speeds observed in a log.

    For a joint that hardly moved, the log contains neither. It may move by 0.3 rad, or
    3 cm, around its position, within its limits, at a quarter of the other joints'
    speed.

    Args:
        model: The robot, for the limits of its joints.
        log: Its recordings of joint positions.
    """
    parts = [r for r in log.recordings if r.position is not None]
    rows = np.concatenate([np.asarray(r.position, dtype=float) for r in parts])
    speeds = np.concatenate(
        [
            np.abs(np.gradient(np.asarray(r.position, dtype=float), r.time, axis=0))
            for r in parts
        ]
    )
    low, high = np.quantile(rows, [0.001, 0.999], axis=0)
    fast = np.quantile(speeds, 0.99, axis=0)
    size = usual_ways(model, log.joints)
    still = high - low < 0.05 * size
    home = np.median(rows, axis=0)
    if still.any():
        usual = float(np.median((fast / size)[~still])) if (~still).any() else 1.0
        fast = np.where(still, 0.25 * usual * size, fast)
        reach = 0.3 * size
        low = np.where(still, home - reach, low)
        high = np.where(still, home + reach, high)
    for column, name in enumerate(log.joints):
        joint = model.joint(name)
        if model.jnt_limited[joint.id]:
            least, most = joint.range
            inside = 0.05 * (most - least)
            ends = max(low[column], least + inside), min(high[column], most - inside)
            # A joint that was at its limit all the time stays where it was.
            if ends[0] < ends[1]:
                low[column], high[column] = ends
    home = np.clip(home, low, high)
    step = float(np.median(np.diff(parts[0].time)))
    rate = float(np.clip(round(1.0 / step), 1, 100))
    return Workspace(log.joints, low, high, fast, home, rate)


def usual_ways(model: mujoco.MjModel, joints: Sequence[str]) -> Array:
    """Return what is to a joint as 1 rad is to a hinge, (joints,): 0.1 m at a slide."""
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in joints]
    slides = [i >= 0 and model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in ids]
    return np.where(slides, 0.1, 1.0)


@dataclass(frozen=True)
class Kind:
    """A kind of motion.

    Attributes:
        name: Its name, a part of a folder name.
        how: Instruction for people; ``{joint}`` is the joint that moves.
        make: ``make(workspace, columns)`` returns goals (T, joints) moving these
            columns.
    """

    name: str
    how: str
    make: Callable[[Workspace, Sequence[int]], Array]


def slow_triangle(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return goals to and fro at a tenth of the speed, with varying turning points."""
    goals = _at_home(workspace)
    for column in columns:
        span = min(
            workspace.high[column] - workspace.low[column],
            2.0 * workspace.speed[column],
        )
        slow = max(0.1 * workspace.speed[column], 0.4 * span / SECONDS)
        turns = np.array([0.5, 0.7, 0.45, 0.6, 0.3, 0.5])
        goals[:, column] = _ramps(workspace, column, turns * span, slow)
    return goals


def cruises(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return goals that leave and come back at constant speeds, slow ones first."""
    goals = _at_home(workspace)
    for column in columns:
        low, high, home = (
            workspace.low[column],
            workspace.high[column],
            workspace.home[column],
        )
        side = 1.0 if high - home > home - low else -1.0
        time, place = [_REST], [0.0]
        for share in (0.02, 0.05, 0.1, 0.3, 0.7):
            speed = share * workspace.speed[column]
            far = min(0.5 * (high - low), 1.3 * speed)
            for there in (far, 0.0):
                time += [time[-1] + far / speed, time[-1] + far / speed + 0.3]
                place += [there, there]
        goals[:, column] = home + side * np.interp(workspace.time, time, place)
    return _back_home(workspace, goals)


def holds(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return goals that rest at poses across the range, approached from both sides."""
    goals = _at_home(workspace)
    order = np.array([0.5, 0.1, 0.9, 0.5, 0.9, 0.3, 0.7, 0.1, 0.5])
    for number, column in enumerate(columns):
        span = workspace.high[column] - workspace.low[column]
        positions = workspace.low[column] + span * np.roll(order, number)
        # Closer to home where the speed limit requires it.
        far = 0.4 * workspace.speed[column] * (SECONDS - 2 * _REST) / len(order)
        nearer = min(1.0, far / (0.9 * span))
        positions = workspace.home[column] + nearer * (
            positions - workspace.home[column]
        )
        goals[:, column] = _visits(workspace, column, positions)
    return goals


def chirp(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return sines with frequencies from 0.1 to 5 Hz, as wide as the speed allows."""
    goals = _at_home(workspace)
    time = np.maximum(workspace.time - _REST, 0.0)
    length = SECONDS - 3.0
    for number, column in enumerate(columns):
        # A different rate for each joint, so that joints do not move alike.
        growth = np.log(50.0) / length
        frequency = 0.1 * np.exp(growth * np.minimum(time, length)) * 0.9**number
        phase = 2.0 * np.pi * np.cumsum(frequency) / workspace.rate
        half = 0.5 * (workspace.high[column] - workspace.low[column])
        wide = np.minimum(half, 0.8 * workspace.speed[column] / (2 * np.pi * frequency))
        middle = 0.5 * (workspace.high[column] + workspace.low[column])
        goals[:, column] = middle + wide * np.sin(phase)
    return _back_home(workspace, goals)


def big_steps(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return step goals, as far as the speed allows in a tenth of a second."""
    goals = _at_home(workspace)
    shares = np.array([0.8, 0.2, 0.6, 0.1, 0.9, 0.4, 0.7, 0.3, 0.95, 0.5, 0.05, 0.6])
    for number, column in enumerate(columns):
        span = workspace.high[column] - workspace.low[column]
        positions = workspace.low[column] + span * np.roll(shares, number)
        index = np.clip((workspace.time - _REST) / 1.4, 0, len(positions) - 1).astype(
            int
        )
        wanted = positions[index]
        step = workspace.speed[column] / workspace.rate
        goals[:, column] = _limited(wanted, workspace.home[column], step)
    return _back_home(workspace, goals)


def fast_sweep(workspace: Workspace, columns: Sequence[int]) -> Array:
    """Return goals over the whole range, to and fro, at the largest speed."""
    goals = _at_home(workspace)
    for column in columns:
        span = workspace.high[column] - workspace.low[column]
        turns = np.tile([0.95, 0.05], 40) * span
        goals[:, column] = _ramps(
            workspace, column, turns, 0.8 * workspace.speed[column]
        )
    return _back_home(workspace, goals)


KINDS = (
    Kind("slow_triangle", "Move {joint} slowly to and fro.", slow_triangle),
    Kind("cruises", "Move {joint} at constant speeds, both ways.", cruises),
    Kind("holds", "Rest {joint} at several poses, reached from both sides.", holds),
    Kind("chirp", "Swing {joint} faster and faster, up to 5 Hz.", chirp),
    Kind("big_steps", "Send {joint} far goals, one after the other.", big_steps),
    Kind("fast_sweep", "Sweep {joint} to and fro at full speed.", fast_sweep),
)


def _at_home(workspace: Workspace) -> Array:
    return np.tile(workspace.home, (len(workspace.time), 1))


def _back_home(workspace: Workspace, goals: Array) -> Array:
    """Ramp goals from home at the start and back at the end, within speed limits."""
    rows = len(goals)
    rest = round(_REST * workspace.rate)
    steps = np.minimum(np.arange(rows), np.arange(rows)[::-1]) - rest // 2
    reach = np.maximum(steps, 0)[:, None] * workspace.speed / workspace.rate
    return np.clip(goals, workspace.home - reach, workspace.home + reach)


def _limited(wanted: Array, start: float, step: float) -> Array:
    """Follow goals by at most one step per row."""
    out = np.empty_like(wanted)
    place = start
    for row, goal in enumerate(wanted):
        place += float(np.clip(goal - place, -step, step))
        out[row] = place
    return out


def _ramps(workspace: Workspace, column: int, turns: Array, speed: float) -> Array:
    """Ramp between turning points, measured from the lower end, at one speed."""
    positions = np.concatenate(
        [[workspace.home[column] - workspace.low[column]], turns]
    )
    times = _REST + np.concatenate(
        [[0.0], np.cumsum(np.abs(np.diff(positions))) / speed]
    )
    goals = workspace.low[column] + np.interp(workspace.time, times, positions)
    rows = np.tile(workspace.home, (len(workspace.time), 1))
    rows[:, column] = np.clip(goals, workspace.low[column], workspace.high[column])
    column_goals: Array = _back_home(workspace, rows)[:, column]
    return column_goals


def _visits(workspace: Workspace, column: int, positions: Array) -> Array:
    """Visit positions along smooth paths, with a rest at each."""
    each = (SECONDS - 2 * _REST) / len(positions)
    way = np.concatenate([[workspace.home[column]], positions])
    number = np.clip((workspace.time - _REST) / each, 0.0, len(positions) - 1e-9)
    index = number.astype(int)
    far = np.abs(way[index + 1] - way[index])
    # The peak speed of a minimum-jerk path is 1.875 times its mean.
    moving = np.maximum(1.875 * far / workspace.speed[column] / each, 1e-3)
    share = np.clip((number - index) / np.minimum(moving, 1.0), 0.0, 1.0)
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    goals = way[index] + smooth * (way[index + 1] - way[index])
    rows = np.tile(workspace.home, (len(workspace.time), 1))
    rows[:, column] = goals
    column_goals: Array = _back_home(workspace, rows)[:, column]
    return column_goals
