"""Batches of short simulations of a task, each with its own model and initial state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import groupby

import mujoco
import numpy as np

from rlco.gap.demos.replay.commands_in_flight import Flight
from rlco.gap.demos.replay.kernel import roll_out_range
from rlco.gap.demos.replay.plants import Plant, Plants
from rlco.gap.logs.log import Array
from rlco.physics.mj.libmujoco import address_of
from rlco.physics.native.effect_kernels import observe_range
from rlco.physics.native.kernels import (
    POSE_SIZE,
    clear_range,
    feature_count,
    forward_range,
)
from rlco.physics.native.processors import available_processors
from rlco.physics.native.stepper import scene_of
from rlco.physics.native.worlds import Worlds
from rlco.physics.spec.control import Control, Integers
from rlco.physics.spec.task import SceneState

ROWS = 64  # simulations in one batch
_LONGEST = 40  # maximum command delay in control steps
_PART = 8  # simulations that one thread runs in sequence


@dataclass(frozen=True)
class Start:
    """An initial state of a simulation, as encoders and camera report it.

    Attributes:
        qpos: Of the whole model, (nq,).
        qvel: Of the whole model, (nv,).
        marks: Position and quaternion of objects fixed for the episode, (G, 7).
        posture: Joint positions that the controller's null space attracts to, (n,)
            [rad].
        grip: The gripper's goals in [-1, 1], (2,).
        running: Whether this is in the middle of an episode.
        flight: Commands in flight, if effects delay them.
    """

    qpos: Array
    qvel: Array
    marks: Array
    posture: Array
    grip: Array
    running: bool = False
    flight: Flight | None = None


@dataclass(frozen=True)
class Job:
    """One simulation.

    Attributes:
        plant: The simulated plant.
        start: The initial state.
        actions: Commands, (H, A).
        before: An earlier state and the commands between the two. The arm then starts
            with the velocity it reaches from there, which is more accurate than any
            log.
    """

    plant: Plant
    start: Start
    actions: Array
    before: tuple[Start, Array] | None = None


@dataclass(frozen=True)
class _Pool:
    """Physical states shared by jobs, and those that their controllers observe."""

    worlds: Worlds
    true: Integers
    observed: Integers


class Rollouts:
    """Step batches of simulations in threads.

    Args:
        plants: Source of the models.
        threads: Python threads; one per core by default.
    """

    def __init__(self, plants: Plants, threads: int | None = None) -> None:
        self.plants = plants
        self._threads = ThreadPoolExecutor(threads or available_processors())
        self._pools: dict[tuple[int, ...], _Pool] = {}

    def run(self, jobs: Sequence[Job]) -> list[Array | None]:
        """Return the features after each step of each job, (H, features).

        None stands for a simulation that diverged. Jobs of one plant should be
        adjacent.
        """
        found: list[Array | None] = []
        for _, alike in groupby(jobs, key=lambda job: _sizes(job.plant.model)):
            rows = list(alike)
            pool = self._pool_for(rows[0].plant)
            for first in range(0, len(rows), ROWS):
                found += self._batch(pool, rows[first : first + ROWS])
        return found

    def scene(self, features: Array) -> SceneState:
        """Return features (..., F) as a state, without marks."""
        lead = features.shape[:-1]
        placed = np.zeros((*lead, len(self.plants.task.goals), POSE_SIZE))
        tracked = self.plants.nominal.tracked
        return scene_of(features, tracked, placed, np.zeros(lead, dtype=np.int64))

    def _pool_for(self, plant: Plant) -> _Pool:
        sizes = _sizes(plant.model)
        if sizes in self._pools:
            return self._pools[sizes]
        worlds = Worlds(
            plant.model,
            self.plants.control,
            (plant.stiffness, plant.damping),
            num_envs=ROWS,
            threads=1,
            longest_delay=_LONGEST,
            controller_model=self.plants.plain,
        )
        memory = worlds.memory
        pool = _Pool(worlds, memory.fields.copy(), memory.observed.copy())
        self._pools[sizes] = pool
        return pool

    def follow(
        self, jobs: Sequence[Job], correct: Callable[[int, int, mujoco.MjData], None]
    ) -> None:
        """Run jobs of one plant step by step, with a correction after each step.

        Args:
            jobs: The jobs.
            correct: ``correct(job, steps, data)`` changes positions and velocities of
                a job after that many steps; it is first called with 0.
        """
        pool = self._pool_for(jobs[0].plant)
        for first in range(0, len(jobs), ROWS):
            part = jobs[first : first + ROWS]
            self._begin(pool, part)
            for done in range(max(len(job.actions) for job in part) + 1):
                remaining = [done < len(job.actions) for job in part]
                for row, job in enumerate(part):
                    if done <= len(job.actions):
                        correct(first + row, done, pool.worlds.data[row])
                step = [
                    job.actions[done : done + 1] if more else job.actions[:0]
                    for job, more in zip(part, remaining, strict=True)
                ]
                self._step(pool, part, step)

    def _batch(self, pool: _Pool, jobs: list[Job]) -> list[Array | None]:
        if all(job.before is None for job in jobs):
            self._begin(pool, jobs)
            return self._step(pool, jobs, [job.actions for job in jobs])
        ways = [job.before or (job.start, job.actions[:0]) for job in jobs]
        self._begin(pool, [Job(j.plant, w[0], w[1]) for j, w in _pairs(jobs, ways)])
        self._step(pool, jobs, [way[1] for way in ways])
        memory = pool.worlds.memory
        reached = memory.ctrl[: len(jobs)].copy()
        speeds = [_arm_speed(pool, row, job) for row, job in enumerate(jobs)]
        jobs = [
            replace(job, start=replace(job.start, qvel=speed))
            for job, speed in _pairs(jobs, speeds)
        ]
        self._begin(pool, jobs)
        arrived = [row for row, job in enumerate(jobs) if job.start.running]
        memory.ctrl[arrived] = reached[arrived]
        return self._step(pool, jobs, [job.actions for job in jobs])

    def _begin(self, pool: _Pool, jobs: Sequence[Job]) -> None:
        """Set jobs to their initial states."""
        memory, which = pool.worlds.memory, np.arange(len(jobs))
        for row, job in enumerate(jobs):
            _configure(pool, row, job)
        clear_range(which, memory)
        for row, job in enumerate(jobs):
            _place(pool.worlds.data[row], job)
        forward_range(which, memory)
        for row, job in enumerate(jobs):
            _hold(pool.worlds, row, job)

    def _step(
        self, pool: _Pool, jobs: Sequence[Job], commands: Sequence[Array]
    ) -> list[Array | None]:
        """Execute the actions of jobs, from their current states."""
        memory, tracked = pool.worlds.memory, jobs[0].plant.tracked
        steps = np.array([len(rows) for rows in commands], dtype=np.int64)
        size = len(self.plants.task.action_names)
        actions = np.zeros((len(jobs), int(steps.max()), size))
        for row, rows in enumerate(commands):
            actions[row, : len(rows)] = rows
        out = np.empty((len(jobs), actions.shape[1], feature_count(tracked)))
        running = [
            self._threads.submit(
                roll_out_range,
                first,
                last,
                control,
                memory,
                tracked,
                actions,
                steps,
                out,
            )
            for first, last, control in _parts(jobs)
        ]
        for one in running:
            one.result()
        return [
            None if memory.broken[row] else out[row, : steps[row]]
            for row in range(len(jobs))
        ]


def _pairs[A, B](first: Sequence[A], second: Sequence[B]) -> Iterator[tuple[A, B]]:
    return zip(first, second, strict=True)


def _arm_speed(pool: _Pool, row: int, job: Job) -> Array:
    """Return an initial state's velocities, with the arm's taken from a row."""
    speed = job.start.qvel
    if job.before is not None and not pool.worlds.memory.broken[row]:
        dofs, gains = job.plant.control.arm_dof, job.plant.control.acting.reported_speed
        speed = speed.copy()
        speed[dofs] = (gains * pool.worlds.data[row].qvel)[dofs]
    return speed


def _configure(pool: _Pool, row: int, job: Job) -> None:
    """Set the model, the controller and the commands of a row to those of a job."""
    memory, plant, start = pool.worlds.memory, job.plant, job.start
    memory.models[row] = plant.model._address
    controller_model = plant.control.acting.controller_model
    memory.observed[row] = (pool.observed if controller_model else pool.true)[row]
    memory.friction[row] = address_of(plant.model.dof_frictionloss)
    memory.coulomb[row] = plant.friction
    memory.stiffness[row], memory.damping[row] = plant.stiffness, plant.damping
    memory.posture[row], memory.grip[row] = start.posture, start.grip
    memory.broken[row] = memory.unread[row] = False
    memory.clock[row] = int(start.running)
    memory.action[row], memory.pending[row] = 0.0, 0.0
    flight = start.flight
    if flight is not None:
        memory.clock[row], memory.unread[row] = flight.clock, flight.unread
        memory.action[row] = flight.action
        memory.pending[row, : len(flight.pending)] = flight.pending
        memory.goal[row, :3] = flight.goal
        memory.goal_rotation[row] = flight.goal_rotation


def _place(data: mujoco.MjData, job: Job) -> None:
    """Write a job's initial state, after a reset of its data."""
    plant, start = job.plant, job.start
    acting, tracked = plant.control.acting, plant.tracked
    data.qpos[:] = (start.qpos - acting.reported[1]) / acting.reported[0]
    data.qvel[:] = start.qvel / acting.reported_speed
    data.mocap_pos[tracked.mocap] = start.marks[:, :3]
    data.mocap_quat[tracked.mocap] = start.marks[:, 3:]


def _hold(worlds: Worlds, row: int, job: Job) -> None:
    """Show the controller the initial state, and let lagging actuators hold it."""
    control, memory = job.plant.control, worlds.memory
    observe_range(np.array([row]), control, memory)
    data = worlds.data[row]
    memory.ctrl[row, control.arm_ctrl] = data.qfrc_bias[control.arm_dof]
    low, high = control.finger_range.T
    goal = 0.5 * (high + low) + 0.5 * (high - low) * memory.grip[row]
    memory.ctrl[row, control.finger_ctrl] = goal


def _parts(jobs: Sequence[Job]) -> Iterator[tuple[int, int, Control]]:
    """Yield the ranges of rows that one thread runs, with their controller."""
    first = 0
    for _, alike in groupby(jobs, key=lambda job: id(job.plant)):
        last = first + len(list(alike))
        control = jobs[first].plant.control
        # Friction that changes in each step is written into the plant's only model.
        part = last - first if control.acting.forces.friction.rows.size else _PART
        for begin in range(first, last, part):
            yield begin, min(begin + part, last), control
        first = last


def _sizes(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the sizes of the arrays in a state."""
    return model.nbody, model.njnt, model.ngeom, model.nsite, model.nM, model.nu
