"""Torques of a two-link arm whose model is wrong in many numbers at once."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from hidden_arms import FPS
from numpy.typing import NDArray

from rlco.gap.logs.log import Log, Recording

Array = NDArray[np.float64]
JOINTS = ("shoulder", "elbow")
# Two links about axes that are not parallel: all of a load's place shows.
XML = """
<mujoco><compiler angle="radian"/>
<option timestep="0.0005"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0.7" damping="0.2" armature="0.01"/>
<inertial pos="0.1 0 0.02" mass="0.5" diaginertia="0.001 0.002 0.002"/>
<body name="lower" pos="0.2 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"
armature="0.01"/>
<inertial pos="0.08 0.01 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
</body></body></worldbody><actuator>
<position name="shoulder" joint="shoulder" kp="40" kv="2"/>
<position name="elbow" joint="elbow" kp="20" kv="1"/></actuator></mujoco>
"""
Hide = Callable[[mujoco.MjModel], None]


def wrong_everywhere(model: mujoco.MjModel) -> None:
    """Change masses, inertias, damping and armatures by 10 to 30 %; add friction."""
    model.body_mass[1:] *= 1.2, 0.8
    model.body_inertia[1:] *= np.array([[0.85], [1.3]])
    model.body_ipos[1:, 0] += 0.01, -0.008
    model.dof_damping[:] *= 1.3, 0.75
    model.dof_armature[:] *= 0.8, 1.25
    model.dof_frictionloss[:] = 0.05, 0.03


def sines(random: np.random.Generator, seconds: float = 4.0) -> Array:
    """Return goals without jumps, which no derivative of positions would show."""
    time, found = np.arange(int(seconds * FPS)) / FPS, []
    for _ in JOINTS:
        goal = np.zeros_like(time)
        for frequency in random.uniform(0.2, 1.2, 4):
            phase = random.uniform(0.0, 2.0 * np.pi)
            goal += 0.35 * np.sin(2.0 * np.pi * frequency * time + phase)
        found.append(goal - goal[0])
    return np.stack(found, axis=1)


def reaches(random: np.random.Generator, seconds: float = 6.0) -> Array:
    """Return smooth moves of a second between random poses, with rests of half one."""
    time = np.arange(int(seconds * FPS)) / FPS
    goal, pose = np.zeros((len(time), len(JOINTS))), np.zeros(len(JOINTS))
    for start in np.arange(0.5, seconds, 1.5):
        wanted = random.uniform(-0.8, 0.8, len(JOINTS))
        part = np.clip(time - start, 0.0, 1.0)
        goal += (part**3 * (10 - 15 * part + 6 * part**2))[:, None] * (wanted - pose)
        pose = wanted
    return goal


def record_torques(
    *hide: Hide,
    seed: int = 0,
    episodes: int = 3,
    read: Callable[[Array], object] = len,
    motion: Callable[[np.random.Generator], Array] = sines,
    act: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None,
) -> Log:
    """Record the motors' torques in motion that depends on the seed.

    Args:
        hide: What changes the arm's numbers.
        seed: Of the motion and the noise.
        episodes: Recordings of 4 s each.
        read: Changes the torques that are reported, in place.
        motion: Goals of a recording, (rows, joints).
        act: Pushes at each step besides.
    """
    recordings = []
    for episode in range(episodes):
        model = mujoco.MjModel.from_xml_string(XML)
        for change in hide:
            change(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data, random = mujoco.MjData(model), np.random.default_rng([seed, episode])
        sent = motion(random)
        position, torque = np.empty_like(sent), np.empty_like(sent)
        every = round(1 / FPS / model.opt.timestep)
        for frame in range(len(sent)):
            # A drive interpolates: its torque does not jump at each command.
            last = sent[max(frame - 1, 0)]
            for part in np.arange(1, every + 1) / every:
                data.ctrl[:] = last + part * (sent[frame] - last)
                if act is not None:
                    act(model, data)
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            position[frame], torque[frame] = data.qpos, data.qfrc_actuator
        position += 1e-4 * random.standard_normal(position.shape)
        torque += 0.01 * random.standard_normal(torque.shape)
        read(torque)
        time = np.arange(len(sent)) / FPS
        recordings.append(Recording(f"{episode}", time, position, torque=torque))
    return Log(tuple(recordings), JOINTS)


def loaded_hand(model: mujoco.MjModel) -> None:
    """Add 0.1 kg at the lower link, 0.15 m from the elbow along its axis."""
    mass, centre = model.body_mass[2], model.body_ipos[2].copy()
    place, total = np.array([0.15, 0.0, 0.0]), mass + 0.1
    where = (mass * centre + 0.1 * place) / total
    whole = np.diag(model.body_inertia[2])
    for weight, arm in ((mass, centre - where), (0.1, place - where)):
        whole += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, axes = np.linalg.eigh(whole)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    mujoco.mju_mat2Quat(model.body_iquat[2], axes.ravel())
    model.body_inertia[2], model.body_ipos[2] = moments, where
    model.body_mass[2] = total
    model.body_sameframe[2] = model.body_simple[2] = 0
