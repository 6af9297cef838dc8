"""Many short simulations of a task at once, each of its own model and start."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import groupby

import mujoco
import numpy as np

from rlco.gap.log import Array
from rlco.gap.task_flight import Flight
from rlco.gap.task_kernel import roll_out_range
from rlco.gap.task_plants import Plant, Plants
from rlco.physics.arm_control import Control, Integers
from rlco.physics.copies import Copies
from rlco.physics.effect_kernels import look_range
from rlco.physics.libmujoco import address_of
from rlco.physics.native import scene_of
from rlco.physics.native_kernels import OBJECTS, clear_range, forward_range
from rlco.physics.task import SceneState

ROWS = 64  # simulations in one batch
_LONGEST = 40  # control steps that a command may travel
_PART = 8  # simulations that one thread runs in a row


@dataclass(frozen=True)
class Start:
    """A state that a simulation may start from, as encoders and camera tell it.

    Attributes:
        qpos: Of the whole model, (nq,).
        qvel: Of the whole model, (nv,).
        marks: Position and quaternion of what the episode places, (G, 7).
        posture: Where the controller's null space pulls the arm, (7,) [rad].
        grip: The gripper's goals in [-1, 1], (2,).
        running: Whether this is in the middle of an episode.
        flight: Commands on their way, where effects delay them.
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
        plant: What is simulated.
        start: Where it starts.
        actions: What it is told, (H, 7).
        before: An earlier state and what was told between the two: the arm then starts
            with the speed at which it comes from there, which no log tells as well.
    """

    plant: Plant
    start: Start
    actions: Array
    before: tuple[Start, Array] | None = None


@dataclass(frozen=True)
class _Pool:
    """States that jobs take turns with, and those that their controllers see."""

    copies: Copies
    true: Integers
    seen: Integers


class Rollouts:
    """Steps batches of simulations in threads.

    Args:
        plants: Whose models are simulated.
        threads: Python threads; one a core by default.
    """

    def __init__(self, plants: Plants, threads: int | None = None) -> None:
        self.plants = plants
        self._threads = ThreadPoolExecutor(threads or os.cpu_count() or 1)
        self._pools: dict[tuple[int, ...], _Pool] = {}

    def run(self, jobs: Sequence[Job]) -> list[Array | None]:
        """Return the features after each step of each job, (H, features).

        None stands for a simulation that diverged. Jobs of one plant should come one
        after the other.
        """
        found: list[Array | None] = []
        for _, alike in groupby(jobs, key=lambda job: _sizes(job.plant.model)):
            rows = list(alike)
            pool = self._pool_for(rows[0].plant)
            for first in range(0, len(rows), ROWS):
                found += self._batch(pool, rows[first : first + ROWS])
        return found

    def scene(self, features: Array) -> SceneState:
        """Return features (..., F) as a state, without what the episode places."""
        lead = features.shape[:-1]
        placed = np.zeros((*lead, len(self.plants.task.goals), 7))
        objects = self.plants.nominal.tracked.objects.size
        return scene_of(features, objects, placed, np.zeros(lead, dtype=np.int64))

    def _pool_for(self, plant: Plant) -> _Pool:
        sizes = _sizes(plant.model)
        if sizes in self._pools:
            return self._pools[sizes]
        copies = Copies(
            plant.model,
            self.plants.control,
            (plant.stiffness, plant.damping),
            num_envs=ROWS,
            threads=1,
            command_delay=_LONGEST,
            believed=self.plants.nominal.model,
        )
        memory = copies.memory
        memory.delay[:] = 0
        pool = _Pool(copies, memory.fields.copy(), memory.seen.copy())
        self._pools[sizes] = pool
        return pool

    def follow(
        self, jobs: Sequence[Job], correct: Callable[[int, int, mujoco.MjData], None]
    ) -> None:
        """Run jobs of one plant a step at a time, and correct each after each step.

        Args:
            jobs: The jobs.
            correct: ``correct(job, steps, data)`` changes positions and velocities of
                a job after so many steps; before the first it is called with 0.
        """
        pool = self._pool_for(jobs[0].plant)
        for first in range(0, len(jobs), ROWS):
            part = jobs[first : first + ROWS]
            self._begin(pool, part)
            for done in range(max(len(job.actions) for job in part) + 1):
                left = [done < len(job.actions) for job in part]
                for row, job in enumerate(part):
                    if done <= len(job.actions):
                        correct(first + row, done, pool.copies.data[row])
                step = [
                    job.actions[done : done + 1] if more else job.actions[:0]
                    for job, more in zip(part, left, strict=True)
                ]
                self._step(pool, part, step)

    def _batch(self, pool: _Pool, jobs: list[Job]) -> list[Array | None]:
        if all(job.before is None for job in jobs):
            self._begin(pool, jobs)
            return self._step(pool, jobs, [job.actions for job in jobs])
        ways = [job.before or (job.start, job.actions[:0]) for job in jobs]
        self._begin(pool, [Job(j.plant, w[0], w[1]) for j, w in _pairs(jobs, ways)])
        self._step(pool, jobs, [way[1] for way in ways])
        memory = pool.copies.memory
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
        """Place jobs at their starts."""
        memory, which = pool.copies.memory, np.arange(len(jobs))
        for row, job in enumerate(jobs):
            _configure(pool, row, job)
        clear_range(which, memory)
        for row, job in enumerate(jobs):
            _place(pool.copies.data[row], job)
        forward_range(which, memory)
        for row, job in enumerate(jobs):
            _hold(pool.copies, row, job)

    def _step(
        self, pool: _Pool, jobs: Sequence[Job], told: Sequence[Array]
    ) -> list[Array | None]:
        """Let jobs do what they are told, from where they are."""
        memory, tracked = pool.copies.memory, jobs[0].plant.tracked
        steps = np.array([len(rows) for rows in told], dtype=np.int64)
        actions = np.zeros((len(jobs), int(steps.max()), 7))
        for row, rows in enumerate(told):
            actions[row, : len(rows)] = rows
        size = OBJECTS + 7 * tracked.objects.size + tracked.fixture_qpos.size
        out = np.empty((len(jobs), actions.shape[1], size))
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
    """Return a start's velocities, the arm's being those of a row."""
    speed = job.start.qvel
    if job.before is not None and not pool.copies.memory.broken[row]:
        dofs, told = job.plant.control.arm_dof, job.plant.control.acting.told_speed
        speed = speed.copy()
        speed[dofs] = (told * pool.copies.data[row].qvel)[dofs]
    return speed


def _configure(pool: _Pool, row: int, job: Job) -> None:
    """Give a row the model, the controller and the commands of a job."""
    memory, plant, start = pool.copies.memory, job.plant, job.start
    memory.models[row] = plant.model._address
    believed = plant.control.acting.believed
    memory.seen[row] = (pool.seen if believed else pool.true)[row]
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
    """Write the state that a job starts from, after a reset of its data."""
    plant, start = job.plant, job.start
    acting, tracked = plant.control.acting, plant.tracked
    data.qpos[:] = (start.qpos - acting.told[1]) / acting.told[0]
    data.qvel[:] = start.qvel / acting.told_speed
    data.mocap_pos[tracked.mocap] = start.marks[:, :3]
    data.mocap_quat[tracked.mocap] = start.marks[:, 3:]


def _hold(copies: Copies, row: int, job: Job) -> None:
    """Let the controller see the start, and lagging actuators hold the arm there."""
    control, memory = job.plant.control, copies.memory
    look_range(np.array([row]), control, memory)
    data = copies.data[row]
    memory.ctrl[row, control.arm_ctrl] = data.qfrc_bias[control.arm_dof]
    low, high = control.finger_range.T
    goal = 0.5 * (high + low) + 0.5 * (high - low) * memory.grip[row]
    memory.ctrl[row, control.finger_ctrl] = goal


def _parts(jobs: Sequence[Job]) -> Iterator[tuple[int, int, Control]]:
    """Yield stretches of rows that one thread runs, with their controller."""
    first = 0
    for _, alike in groupby(jobs, key=lambda job: id(job.plant)):
        last = first + len(list(alike))
        control = jobs[first].plant.control
        # Friction that changes in each step is written into the plant's one model.
        part = last - first if control.acting.terms else _PART
        for begin in range(first, last, part):
            yield begin, min(begin + part, last), control
        first = last


def _sizes(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return what decides how large a state is."""
    return model.nbody, model.njnt, model.ngeom, model.nsite, model.nM, model.nu
