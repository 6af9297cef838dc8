"""A servo that drives a pendulum, stepped in compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.gap.log import Array
from rlco.gap.problem import Integers


class Plant(NamedTuple):
    """What turns and what drives it, of one hypothesis.

    Attributes:
        inertia: About the joint, with the armature [kg m^2].
        gravity_sin: Torque of gravity at a quarter turn, against it [N m].
        gravity_cos: Torque of gravity at zero, against it [N m].
        stiffness: Of a spring [N m/rad].
        rest: Where the spring rests [rad].
        damping: [N m s/rad].
        friction: Coulomb's [N m].
        static: Friction beyond it at rest [N m].
        stribeck_speed: Where that has fallen to 1/e [rad/s].
        load: Friction for each unit of the torque that the gear carries.
        stall: Torque of the full duty at standstill [N m].
        back_emf: Torque lost for each unit of speed [N m s/rad].
        bias: Constant torque [N m].
        limit: Largest torque of the drive at standstill [N m].
        loss: Torque lost, as a part of it for each unit of torque [1/(N m)].
        stiff: Factor on the firmware's gain.
    """

    inertia: float
    gravity_sin: float
    gravity_cos: float
    stiffness: float
    rest: float
    damping: float
    friction: float
    static: float
    stribeck_speed: float
    load: float
    stall: float
    back_emf: float
    bias: float
    limit: float
    loss: float
    stiff: float


class Runs(NamedTuple):
    """What was sent in each of R runs, S physics steps in all.

    Attributes:
        first: First step of each run, and the end of the last one, (R + 1,).
        goal: Commanded position, (S,) [rad].
        enabled: Whether the drive was on, (S,).
        gain: Duty for each radian of error, (R,) [1/rad].
        start: Position and speed at the first step, (R, 2).
        place: When each logged row was, in steps from the first one, (rows,).
    """

    first: Integers
    goal: Array
    enabled: NDArray[np.bool_]
    gain: Array
    start: Array
    place: Array


@njit(cache=True, nogil=True)
def simulate(plant: Plant, runs: Runs, step: float) -> Array:
    """Return the position before each physics step of each run, (S,) [rad].

    The drive is a voltage of a duty behind a resistance, the firmware a gain (BAM,
    arXiv 2410.08650); friction acts as MuJoCo's does, against the motion and never
    beyond the torque that would stop it within the step; damping is implicit.
    """
    track = np.empty(len(runs.goal))
    for run in range(len(runs.gain)):
        position, speed = runs.start[run]
        gain = runs.gain[run] * plant.stiff
        for row in range(runs.first[run], runs.first[run + 1]):
            track[row] = position
            motor = 0.0
            if runs.enabled[row]:
                duty = min(max(gain * (runs.goal[row] - position), -1.0), 1.0)
                motor = duty * plant.stall - plant.back_emf * speed
                motor = min(max(motor, -plant.limit), plant.limit)
                motor /= 1.0 + plant.loss * abs(motor)
            motor += plant.bias
            load = plant.gravity_sin * np.sin(position)
            if plant.gravity_cos != 0.0:
                load += plant.gravity_cos * np.cos(position)
            load += plant.stiffness * (position - plant.rest)
            friction = plant.friction + plant.load * abs(motor + load)
            if plant.static > 0.0:
                part = speed / plant.stribeck_speed
                friction += plant.static * np.exp(-part * part)
            inertia = plant.inertia + step * plant.damping
            momentum = plant.inertia * speed + step * (motor - load)
            stopped = min(abs(momentum), step * friction)
            speed = (momentum - np.sign(momentum) * stopped) / inertia
            position += step * speed
    return track
