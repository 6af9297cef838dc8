"""Path of commands: delays, fixed and random, read period and velocity limit."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numba import njit

from rlco.physics.effects.effect import (
    AppliedEffect,
    Array,
    ControllerTiming,
    Effect,
    Integers,
    Parameter,
)
from rlco.physics.effects.targets import servo_joints

_LONGEST = 60.0  # s that a command may be on its way, or held
_QUANTILES = 1024  # of a random delay's distribution


def _command_delay_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _command_delay_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("delay", "s", 0.0, 0.4, 0.0, (0.02, 0.08), most=_LONGEST),)


def _command_delay_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    # Interpolating between steps gives a fit a gradient.
    steps = np.arange(len(commands)) - values[0] / timestep
    before = np.floor(steps).astype(int)
    part = (steps - before)[:, None]
    first = commands[np.clip(before, 0, None)]
    second = commands[np.clip(before + 1, 0, len(commands) - 1)]
    return np.asarray((1.0 - part) * first + part * second)


def _command_delay_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    timing.delay += float(values[0])


COMMAND_DELAY = Effect(
    name="command_delay",
    summary="Commands reach the actuators late.",
    signature=(
        "The whole answer is shifted in time: a residual in proportion to the "
        "command's speed."
    ),
    confused_with=("actuator_lag", "control_rate", "viscous_damping", "actuator_gain"),
    targets=_command_delay_targets,
    parameters=_command_delay_parameters,
    on_command=_command_delay_on_command,
    on_controller=_command_delay_on_controller,
    order=20,
)


def _random_delay_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (
        Parameter("mean", "s", 0.0, 0.4, 0.0, (0.02, 0.08), most=_LONGEST),
        Parameter("spread", "s", 0.0, 0.2, 0.0, (0.01, 0.04), most=_LONGEST),
    )


def _random_delay_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    mean, spread = float(values[0]), float(values[1])
    if spread == 0.0:
        timing.delay += mean
    else:
        timing.random_mean += mean
        timing.random_variance += spread**2


def _random_delay_refuse(values: Array) -> tuple[str, str] | None:
    mean, spread = float(values[0]), float(values[1])
    if mean == 0.0 < spread:
        return (
            f"spread={spread:g} of delays that are never negative and whose mean is 0",
            "give a mean above 0, or no spread",
        )
    return None


RANDOM_DELAY = Effect(
    name="random_delay",
    summary="Each command arrives late by a random time of its own, in order.",
    signature=(
        "The answer to each command is shifted by another time: a residual in "
        "proportion to the command's speed that no one delay removes."
    ),
    confused_with=("command_delay", "control_rate", "actuator_lag"),
    targets=_command_delay_targets,
    parameters=_random_delay_parameters,
    # Nobody knows when a recorded command arrived: all come late by the mean.
    on_command=_command_delay_on_command,
    on_controller=_random_delay_on_controller,
    order=20,
    shown_by=("positions",),
    candidate=False,
    refuse=_random_delay_refuse,
)


def at_mean_delay(effect: AppliedEffect) -> AppliedEffect:
    """Return an effect whose commands are all late by the mean, if they were at random.

    Example:
        >>> late = AppliedEffect("random_delay", None, {"mean": 0.05, "spread": 0.02})
        >>> at_mean_delay(late).parameters
        {'mean': 0.05, 'spread': 0.0}
    """
    if effect.name != RANDOM_DELAY.name:
        return effect
    return replace(effect, parameters={**effect.parameters, "spread": 0.0})


def delay_quantiles(mean: float, variance: float, timestep: float) -> Integers:
    """Return equally likely delays, as a gamma distribution has them.

    Means and deviations of 1024 such quantiles are within 0.2 % and 1 % of those asked
    for where the deviation is at most twice the mean.

    Args:
        mean: Above 0 [s].
        variance: Above 0 [s^2].
        timestep: Of the physics [s].

    Returns:
        Whole physics steps, ascending, (1024,).

    Example:
        >>> steps = delay_quantiles(0.05, 0.02**2, 0.002)
        >>> float(steps.mean().round(1)), float(steps.std().round(1)), int(steps.max())
        (25.0, 10.0, 71)
    """
    from scipy.special import gammaincinv  # see `actuator_lag`

    shares = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    delays = gammaincinv(mean**2 / variance, shares) * variance / mean
    steps: Integers = np.rint(delays / timestep).astype(np.int64)
    return steps


@njit(nogil=True, cache=True)
def drawn_delay(quantiles: Integers, seed: int, number: int) -> int:
    """Return the delay of an episode's command by its number [physics steps].

    It is a hash of seed and number (SplitMix64; Steele, Lea and Flood 2014, "Fast
    splittable pseudorandom number generators"), so that neither threads nor the order
    of worlds matter.

    Args:
        quantiles: Equally likely delays, (Q,).
        seed: Of the episode.
        number: Of the command; those before the episode's first are below 0.
    """
    word = np.uint64(seed) + np.uint64(number) * np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    word ^= word >> np.uint64(31)
    return int(quantiles[np.int64(word % np.uint64(quantiles.shape[0]))])


@njit(nogil=True, cache=True)
def _read_at(given: int, period: float) -> int:
    """Return the physics step in which a command that is given is read."""
    tick = np.floor((given - 1) / period + 1e-9) + 1.0
    step = max(given, int(np.floor((tick - 1e-9) * period)))
    while np.floor(step / period + 1e-9) < tick:
        step += 1
    return step


@njit(nogil=True, cache=True)
def newest_arrival(
    quantiles: Integers,
    seed: int,
    fixed: int,
    period: float,
    substeps: int,
    clock: int,
    passed: int,
    sent: int,
) -> tuple[int, int]:
    """Return which commands have arrived, where each is late by its own time.

    A command arrives not before the one sent before it.

    Args:
        quantiles: Equally likely delays [physics steps], (Q,).
        seed: Of the episode.
        fixed: Delay that all have besides [physics steps].
        period: Physics steps between two reads by the sender; 0: each is read.
        substeps: Physics steps between two commands.
        clock: Physics steps since the reset.
        passed: Number of the last command that is no longer on its way.
        sent: Number of the last command that was given.

    Returns:
        The number of the last command that is not on its way now, and of the last that
        has arrived since `passed`; `passed` where none has.

    Example:
        Every 10 steps a command, late by 12; those before the first are numbered below
        0. At step 13 the first has arrived, and the second has not.
        >>> newest_arrival(np.array([12]), 0, 0, 0.0, 10, 13, -1, 1)
        (0, 0)
    """
    arrived = passed
    while passed < sent:
        number = passed + 1
        read = number * substeps
        # At the start what has arrived is read, whatever the period.
        if period > 0.0 and clock > 0:
            read = _read_at(read, period)
            if read >= (number + 1) * substeps:
                passed = number  # the next command is read instead
                continue
        if read + fixed + drawn_delay(quantiles, seed, number) > clock:
            break
        passed = arrived = number
    return passed, arrived


def _control_rate_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _control_rate_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    # A period a few milliseconds off gets out of phase within a recording.
    starts = tuple(float(start) for start in np.arange(2, 26) / 100)
    step = float(model.opt.timestep)
    size = ("period", "s", 0.0, 0.5, 0.0, starts, False, step)
    return (Parameter(*size, most=_LONGEST),)


def _control_rate_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    period = float(values[0]) / timestep
    if period <= 1.0:
        return commands
    steps = np.arange(len(commands))
    # Rounding must not read a step early, where the command may be another one.
    read = np.floor(steps / period + 1e-6) * period + 1e-6
    held: Array = commands[np.floor(read).astype(int)]
    return held


def _control_rate_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    timing.period += float(values[0])


CONTROL_RATE = Effect(
    name="control_rate",
    summary="Commands are read, and then held, once a period.",
    signature="A staircase: a residual that repeats itself at the controller's rate.",
    confused_with=("command_delay", "actuator_lag"),
    targets=_control_rate_targets,
    parameters=_control_rate_parameters,
    on_command=_control_rate_on_command,
    on_controller=_control_rate_on_controller,
    order=10,
    shown_by=("positions", "servo", "task"),
)


def _velocity_limit_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    starts = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
    return (Parameter("limit", "rad/s", 0.02, 20.0, 20.0, starts, False),)


@njit(cache=True)
def _follow(commands: Array, largest: float) -> Array:
    followed = np.empty_like(commands)
    goal = commands[0]
    for step in range(len(commands)):
        change = commands[step] - goal
        goal += min(max(change, -largest), largest)
        followed[step] = goal
    return followed


def _velocity_limit_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    goal = np.ascontiguousarray(commands[:, column])
    commands[:, column] = _follow(goal, float(values[0]) * timestep)
    return commands


VELOCITY_LIMIT = Effect(
    name="velocity_limit",
    summary="A servo's internal goal moves at most at this speed.",
    signature="Steps are answered by ramps of one slope.",
    confused_with=("torque_limit", "actuator_lag"),
    targets=servo_joints,
    parameters=_velocity_limit_parameters,
    on_command=_velocity_limit_on_command,
    order=30,
    shown_by=("positions", "servo"),
)
