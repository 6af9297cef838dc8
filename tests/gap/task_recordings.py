"""Logs of push_cube by its scripted expert, with a hidden mass, friction or damping.

What is hidden is written into the arrays of the compiled model, not by the effects that
a search would apply. Built once for all tests: robosuite takes seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rlco.gap.demos.replay.plants import Plants
from rlco.gap.demos.replay.rollouts import Rollouts
from rlco.gap.logs.log import Log
from rlco.gap.logs.task_log import task_recording
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.task import InitialState, SceneState
from rlco.physics.tasks.push_cube import TASK

Array = NDArray[np.float64]

EPISODES = 4
STEPS = 66
CUBES = ("red_cube_main", "green_cube_main", "blue_cube_main")


@cache
def plants() -> Plants:
    return Plants(TASK, SIM)


@cache
def rollouts() -> Rollouts:
    return Rollouts(plants(), threads=1)


@cache
def stepper() -> NativeStepper:
    return NativeStepper(TASK, SIM, num_envs=EPISODES, threads=1)


def hidden_mass(factor: float) -> dict[str, Array]:
    model = stepper().model
    mass, inertia = model.body_mass.copy(), model.body_inertia.copy()
    for name in CUBES:
        mass[model.body(name).id] *= factor
        inertia[model.body(name).id] *= factor
    return {"body_mass": mass, "body_inertia": inertia}


def hidden_friction(friction: float) -> dict[str, Array]:
    all_of_it = stepper().model.geom_friction.copy()
    all_of_it[:, 0] = friction
    return {"geom_friction": all_of_it}


def hidden_damping(joint: str, damping: float) -> dict[str, Array]:
    model = stepper().model
    every = model.dof_damping.copy()
    every[model.joint(joint).dofadr[0]] += damping
    return {"dof_damping": every}


def record(
    fields: Mapping[str, Array] | None = None,
    *,
    robot: NativeStepper | None = None,
    seed: int = 0,
    steps: int = STEPS,
) -> tuple[Log, list[SceneState]]:
    """Let the expert play; return the log, and the true states row by row."""
    robot = robot or stepper()
    everyone = np.arange(EPISODES)
    robot.worlds.restore_models(everyone)
    if fields:
        robot.randomise(everyone, fields)
    rngs = [np.random.default_rng([seed, i]) for i in everyone]
    truth = [robot.reset([start(rng) for rng in rngs])]
    told, seen, sent = [], [], []
    for _ in range(steps):
        jitter = np.stack([rng.standard_normal(7) for rng in rngs])
        noise = np.stack([rng.standard_normal(noise_size(TASK)) for rng in rngs])
        state, scene = observe(TASK, SIM, robot.reported_state(), noise)
        action = TASK.expert(truth[-1]) + 0.1 * jitter * (np.arange(7) < 3)
        action = np.clip(action, -1.0, 1.0)
        told.append(state)
        seen.append(scene)
        sent.append(action)
        truth.append(robot.step(action[:, None]).at(np.s_[:, 1]))
    recordings = tuple(
        task_recording(
            TASK,
            f"episode {i}",
            state=np.stack(told)[:, i].astype(np.float32),
            environment_state=np.stack(seen)[:, i].astype(np.float32),
            action=np.stack(sent)[:, i],
        )
        for i in everyone
    )
    return Log(recordings), truth


def start(rng: np.random.Generator) -> InitialState:
    """Draw a start in which the red cube is to be pushed."""
    drawn = TASK.sample(rng, None)
    return InitialState(**{**vars(drawn), "instruction_id": 0})


@cache
def plain_log() -> Log:
    return record()[0]
