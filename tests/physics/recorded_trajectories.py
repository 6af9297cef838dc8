"""Trajectories of both domains, and the file that holds them as they were.

    PYTHONPATH=tests/physics python tests/physics/recorded_trajectories.py

records them anew. That is right only where a change of the physics is meant.
"""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.domain import make_domain
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.task import InitialState, SceneState, Task
from rlco.physics.tasks.make_task import make_task

Arrays = dict[str, NDArray[np.float64]]
FILE = Path(__file__).parent / "native" / "recorded_trajectories.npz"
DOMAINS = ("sim", "stand_in")
BACKENDS = {"native": NativeStepper, "robosuite": RobosuiteStepper}
SEED = 20260
# Control steps after which the expert of each task touches what it moves.
CONTACT = {"push_cube": 30, "pick_and_place": 25, "open_drawer": 40, "close_drawer": 30}
READ_AT = (20, 40)  # control steps at which a trajectory is written down


def fingerprint() -> str:
    """Return what decides how numbers are rounded: processor and libraries."""
    cpu = platform.processor()
    if (info := Path("/proc/cpuinfo")).exists():
        wanted = ("model name", "cpu family", "model\t", "flags")
        lines = info.read_text().split("\n\n")[0].splitlines()
        cpu = " ".join(line for line in lines if line.startswith(wanted))
    libraries = ("mujoco", "numba", "numpy", "robosuite", "scipy")
    return " ".join([cpu, *(f"{name} {version(name)}" for name in libraries)])


def starts_and_actions(task: Task) -> tuple[Arrays, NDArray[np.float64]]:
    """Return three starts, one of them at contact, and actions (3, 40, A).

    The first two are the expert's and, for the second, random numbers. The expert's
    are those that it gives in ``sim``.
    """
    rng = np.random.default_rng(SEED)
    drawn = [task.sample(np.random.default_rng([SEED, i]), None) for i in range(2)]
    stepper = NativeStepper(task, make_domain("sim"), num_envs=1, threads=1)
    state = stepper.reset(drawn[:1])
    actions = []
    for _ in range(CONTACT[task.name] + READ_AT[-1]):
        actions.append(task.expert(state)[0])
        state = stepper.step(actions[-1][None, None]).at(np.s_[:, 1])
        if len(actions) == CONTACT[task.name]:
            drawn.append(_start_at(state.at(0)))
    noise = rng.uniform(-1.0, 1.0, (READ_AT[-1], len(actions[0])))
    chosen = [actions[: READ_AT[-1]], noise, actions[CONTACT[task.name] :]]
    rows = [_row(start) for start in drawn]
    # Half the digits: half the file.
    return {k: np.stack([row[k] for row in rows]) for k in rows[0]}, np.array(
        chosen, dtype=np.float32
    ).astype(np.float64)


def _start_at(state: SceneState) -> InitialState:
    """Return the start that places everything as it is in a state, at rest."""
    pose = np.concatenate([state.object_position, state.object_quaternion], axis=-1)
    fixtures = state.joint_opening.size
    return InitialState(
        joint_position=state.joint_position,
        object_pose=pose[: len(pose) - fixtures],
        goal_position=state.goal_position,
        goal_quaternion=state.goal_quaternion,
        joint_opening=state.joint_opening,
        instruction_id=int(state.instruction_id),
        gripper_opening=float(state.gripper_opening),
    )


def _row(start: InitialState) -> Arrays:
    return {
        "joint_position": start.joint_position,
        "object_pose": start.object_pose,
        "goal_position": start.goal_position,
        "goal_quaternion": start.goal_orientation(),
        "joint_opening": start.fixture_opening(),
        "instruction_id": np.array(start.instruction_id),
        "gripper_opening": np.array(start.gripper_opening),
    }


def start_of(rows: Arrays, number: int) -> InitialState:
    """Return one start of the file."""
    row = {name: value[number] for name, value in rows.items()}
    instruction, opening = int(row.pop("instruction_id")), row.pop("gripper_opening")
    return InitialState(
        **row, instruction_id=instruction, gripper_opening=float(opening)
    )


def played(
    name: str, domain: str, backend: str, starts: Arrays, actions: NDArray[np.float64]
) -> Arrays:
    """Return what the three episodes come to, leading axes (3, READ_AT)."""
    task, place = make_task(name), make_domain(domain)
    stepper = BACKENDS[backend](task, place, num_envs=1)
    noise = np.random.default_rng(SEED).standard_normal(noise_size(task))
    rows = []
    for number, commands in enumerate(actions):
        stepper.reset([start_of(starts, number)])
        before = 0
        for until in READ_AT:
            state = stepper.step(commands[None, before:until]).at((0, -1))
            reported = stepper.reported_state().at(0)
            robot, scene = observe(task, place, reported, noise)
            rows.append(
                {
                    "joints": state.joint_position,
                    "gripper": state.gripper_opening,
                    "objects": state.object_position,
                    "turns": state.object_quaternion,
                    "fixtures": state.joint_opening,
                    "robot": robot,
                    "scene": scene,
                }
            )
            before = until
    lead = (len(actions), len(READ_AT))
    stacked = {k: np.stack([row[k] for row in rows]) for k in rows[0]}
    return {k: v.reshape(*lead, *v.shape[1:]) for k, v in stacked.items()}


def record() -> None:
    """Write the file."""
    out = {"fingerprint": np.array(fingerprint())}
    for name in TASK_NAMES:
        starts, actions = starts_and_actions(make_task(name))
        out |= {f"{name}/start/{k}": v for k, v in starts.items()}
        out[f"{name}/actions"] = actions.astype(np.float32)
        for domain in DOMAINS:
            for backend in BACKENDS:
                found = played(name, domain, backend, starts, actions)
                lead = f"{name}/{domain}/{backend}"
                out |= {f"{lead}/{k}": v for k, v in found.items()}
    np.savez_compressed(FILE, **out)


if __name__ == "__main__":
    record()
