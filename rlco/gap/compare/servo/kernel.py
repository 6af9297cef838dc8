"""A servo that drives a pendulum, stepped in compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array
from rlco.physics.effects.step_forces import StepForces, law_value


class Plant(NamedTuple):
    """The parameters of load and drive under one hypothesis.

    Attributes:
        inertia: About the joint, with the armature [kg m^2].
        gravity_sin: Torque that holds the load at a quarter turn [N m].
        gravity_cos: Torque that holds the load at zero [N m].
        stiffness: Of a spring [N m/rad].
        rest: The spring's rest position [rad].
        damping: [N m s/rad].
        friction: Coulomb's [N m].
        stall: Stall torque at full duty [N m].
        back_emf: Torque lost per unit of speed [N m s/rad].
        bias: Constant torque [N m].
        limit: Largest torque of the drive at standstill [N m].
        forces: Further friction laws, and torques that are added or lost.
        stiff: Factor on the firmware's gain.
    """

    inertia: float
    gravity_sin: float
    gravity_cos: float
    stiffness: float
    rest: float
    damping: float
    friction: float
    stall: float
    back_emf: float
    bias: float
    limit: float
    forces: StepForces
    stiff: float


class Runs(NamedTuple):
    """The commands of R runs, S physics steps in all.

    Attributes:
        first: First step of each run, and the end of the last one, (R + 1,).
        goal: Commanded position, (S,) [rad].
        enabled: Whether the drive was on, (S,).
        gain: Duty per radian of error, (R,) [1/rad].
        start: Position and speed at the first step, (R, 2).
        place: Time of each logged row, in steps from the first one, (rows,).
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

    The firmware is a gain from error to duty, which sets the winding's voltage (BAM,
    arXiv 2410.08650). As in MuJoCo, friction opposes the motion and never exceeds the
    torque that would stop it within the step; damping is implicit.
    """
    track = np.empty(len(runs.goal))
    frictions, torques = plant.forces
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
            load = plant.gravity_sin * np.sin(position)
            if plant.gravity_cos != 0.0:
                load += plant.gravity_cos * np.cos(position)
            load += plant.stiffness * (position - plant.rest)
            asked = motor
            for law in range(torques.rows.shape[0]):
                carried = abs(asked + load)
                motor += law_value(torques, law, position, speed, asked, carried)
            motor += plant.bias
            carried, friction = abs(motor + load), plant.friction
            for law in range(frictions.rows.shape[0]):
                friction += law_value(frictions, law, position, speed, motor, carried)
            inertia = plant.inertia + step * plant.damping
            momentum = plant.inertia * speed + step * (motor - load)
            stopped = min(abs(momentum), step * friction)
            speed = (momentum - np.sign(momentum) * stopped) / inertia
            position += step * speed
    return track
