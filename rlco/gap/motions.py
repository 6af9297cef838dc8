"""A library of motions that tell effects apart, made for one robot and its log.

Each motion is a list of joint goals at an even rate. It stays in the ranges and below
the speeds that the log shows, starts and ends at one pose, and lasts 20 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.log import Array, Log

SECONDS = 20.0
_REST = 1.0  # at the first and at the last pose [s]


@dataclass(frozen=True)
class Room:
    """Where a robot may move, and how fast.

    Attributes:
        joints: Names of the joints.
        low: Least positions, (joints,) [rad or m].
        high: Largest positions, (joints,).
        speed: Largest speeds, (joints,) [rad/s or m/s].
        home: Where motions start and end, (joints,).
        rate: Goals a second [Hz].
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


def room_of(model: mujoco.MjModel, log: Log) -> Room:
    """Return the ranges and speeds that a log shows.

    Of a joint that hardly moved the log shows neither: it may move by 0.3 rad about
    where it was, within its limits, at a quarter of the other joints' speed.

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
    still = high - low < 0.05
    home = np.median(rows, axis=0)
    if still.any():
        usual = float(np.median(fast[~still])) if (~still).any() else 1.0
        fast = np.where(still, 0.25 * usual, fast)
        low, high = np.where(still, home - 0.3, low), np.where(still, home + 0.3, high)
    for column, name in enumerate(log.joints):
        joint = model.joint(name)
        if model.jnt_limited[joint.id]:
            least, most = joint.range
            inside = 0.05 * (most - least)
            low[column] = max(low[column], least + inside)
            high[column] = min(high[column], most - inside)
    home = np.clip(home, low, high)
    step = float(np.median(np.diff(parts[0].time)))
    rate = float(np.clip(round(1.0 / step), 1, 100))
    return Room(log.joints, low, high, fast, home, rate)


@dataclass(frozen=True)
class Kind:
    """A kind of motion.

    Attributes:
        name: Its name, a part of a folder's.
        how: What to do, for people; ``{joint}`` is the joint that moves.
        make: ``make(room, columns)`` returns goals (T, joints) that move these.
    """

    name: str
    how: str
    make: Callable[[Room, Sequence[int]], Array]


def slow_triangle(room: Room, columns: Sequence[int]) -> Array:
    """Return goals to and fro at a tenth of the speed, turning at other places."""
    goals = _at_home(room)
    for column in columns:
        span = min(room.high[column] - room.low[column], 2.0 * room.speed[column])
        slow = max(0.1 * room.speed[column], 0.4 * span / SECONDS)
        turns = np.array([0.5, 0.7, 0.45, 0.6, 0.3, 0.5])
        goals[:, column] = _ramps(room, column, turns * span, slow)
    return goals


def cruises(room: Room, columns: Sequence[int]) -> Array:
    """Return goals that leave and come back at constant speeds, slow ones first."""
    goals = _at_home(room)
    for column in columns:
        low, high, home = room.low[column], room.high[column], room.home[column]
        side = 1.0 if high - home > home - low else -1.0
        time, place = [_REST], [0.0]
        for share in (0.02, 0.05, 0.1, 0.3, 0.7):
            speed = share * room.speed[column]
            far = min(0.5 * (high - low), 1.3 * speed)
            for there in (far, 0.0):
                time += [time[-1] + far / speed, time[-1] + far / speed + 0.3]
                place += [there, there]
        goals[:, column] = home + side * np.interp(room.time, time, place)
    return _back_home(room, goals)


def holds(room: Room, columns: Sequence[int]) -> Array:
    """Return goals that rest at poses over the range, approached from both sides."""
    goals = _at_home(room)
    order = np.array([0.5, 0.1, 0.9, 0.5, 0.9, 0.3, 0.7, 0.1, 0.5])
    for number, column in enumerate(columns):
        span = room.high[column] - room.low[column]
        places = room.low[column] + span * np.roll(order, number)
        # Nearer to home where the speed does not allow as far.
        far = 0.4 * room.speed[column] * (SECONDS - 2 * _REST) / len(order)
        nearer = min(1.0, far / (0.9 * span))
        places = room.home[column] + nearer * (places - room.home[column])
        goals[:, column] = _visits(room, column, places)
    return goals


def chirp(room: Room, columns: Sequence[int]) -> Array:
    """Return sines whose frequency rises from 0.1 to 5 Hz, as wide as speed allows."""
    goals = _at_home(room)
    time = np.maximum(room.time - _REST, 0.0)
    length = SECONDS - 3.0
    for number, column in enumerate(columns):
        # Each joint's own pace, so that joints do not move alike.
        growth = np.log(50.0) / length
        frequency = 0.1 * np.exp(growth * np.minimum(time, length)) * 0.9**number
        phase = 2.0 * np.pi * np.cumsum(frequency) / room.rate
        half = 0.5 * (room.high[column] - room.low[column])
        wide = np.minimum(half, 0.8 * room.speed[column] / (2 * np.pi * frequency))
        middle = 0.5 * (room.high[column] + room.low[column])
        goals[:, column] = middle + wide * np.sin(phase)
    return _back_home(room, goals)


def big_steps(room: Room, columns: Sequence[int]) -> Array:
    """Return goals that jump, as far as the speed allows in a tenth of a second."""
    goals = _at_home(room)
    shares = np.array([0.8, 0.2, 0.6, 0.1, 0.9, 0.4, 0.7, 0.3, 0.95, 0.5, 0.05, 0.6])
    for number, column in enumerate(columns):
        span = room.high[column] - room.low[column]
        places = room.low[column] + span * np.roll(shares, number)
        index = np.clip((room.time - _REST) / 1.4, 0, len(places) - 1).astype(int)
        wanted = places[index]
        step = room.speed[column] / room.rate
        goals[:, column] = _limited(wanted, room.home[column], step)
    return _back_home(room, goals)


def fast_sweep(room: Room, columns: Sequence[int]) -> Array:
    """Return goals over the whole range, to and fro, at the largest speed."""
    goals = _at_home(room)
    for column in columns:
        span = room.high[column] - room.low[column]
        turns = np.tile([0.95, 0.05], 40) * span
        goals[:, column] = _ramps(room, column, turns, 0.8 * room.speed[column])
    return _back_home(room, goals)


KINDS = (
    Kind("slow_triangle", "Move {joint} slowly to and fro.", slow_triangle),
    Kind("cruises", "Move {joint} at constant speeds, both ways.", cruises),
    Kind("holds", "Rest {joint} at several poses, reached from both sides.", holds),
    Kind("chirp", "Swing {joint} faster and faster, up to 5 Hz.", chirp),
    Kind("big_steps", "Send {joint} far goals, one after the other.", big_steps),
    Kind("fast_sweep", "Sweep {joint} to and fro at full speed.", fast_sweep),
)


def _at_home(room: Room) -> Array:
    return np.tile(room.home, (len(room.time), 1))


def _back_home(room: Room, goals: Array) -> Array:
    """Lead goals from home at the beginning and to home at the end, within speeds."""
    rows = len(goals)
    rest = round(_REST * room.rate)
    steps = np.minimum(np.arange(rows), np.arange(rows)[::-1]) - rest // 2
    reach = np.maximum(steps, 0)[:, None] * room.speed / room.rate
    return np.clip(goals, room.home - reach, room.home + reach)


def _limited(wanted: Array, start: float, step: float) -> Array:
    """Follow goals by at most one step a row."""
    out = np.empty_like(wanted)
    place = start
    for row, goal in enumerate(wanted):
        place += float(np.clip(goal - place, -step, step))
        out[row] = place
    return out


def _ramps(room: Room, column: int, turns: Array, speed: float) -> Array:
    """Go from turn to turn, told from the lower end of the range, at one speed."""
    places = np.concatenate([[room.home[column] - room.low[column]], turns])
    times = _REST + np.concatenate([[0.0], np.cumsum(np.abs(np.diff(places))) / speed])
    goals = room.low[column] + np.interp(room.time, times, places)
    rows = np.tile(room.home, (len(room.time), 1))
    rows[:, column] = np.clip(goals, room.low[column], room.high[column])
    column_goals: Array = _back_home(room, rows)[:, column]
    return column_goals


def _visits(room: Room, column: int, places: Array) -> Array:
    """Go to places along smooth paths and rest at each."""
    each = (SECONDS - 2 * _REST) / len(places)
    way = np.concatenate([[room.home[column]], places])
    number = np.clip((room.time - _REST) / each, 0.0, len(places) - 1e-9)
    index = number.astype(int)
    far = np.abs(way[index + 1] - way[index])
    # A path of minimum jerk is at most 1.875 times as fast as its mean.
    moving = np.maximum(1.875 * far / room.speed[column] / each, 1e-3)
    share = np.clip((number - index) / np.minimum(moving, 1.0), 0.0, 1.0)
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    goals = way[index] + smooth * (way[index + 1] - way[index])
    rows = np.tile(room.home, (len(room.time), 1))
    rows[:, column] = goals
    column_goals: Array = _back_home(room, rows)[:, column]
    return column_goals
