"""Small servo arms with something hidden, recorded by a loop that shares no code."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Log, Recording

FPS = 50
# Two links in a vertical plane, driven by position servos.
TWO_LINKS = """
<mujoco><compiler angle="radian"/>
<option timestep="0.004" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.01"/>
<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.002"/>
<body name="lower" pos="0.2 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"
armature="0.01"/><inertial pos="0.08 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
</body></body></worldbody><actuator>
<position name="shoulder" joint="shoulder" kp="40" kv="2"/>
<position name="elbow" joint="elbow" kp="20" kv="1"/></actuator></mujoco>
"""
# Two turntables: neither feels the other, or its weight.
TURNTABLES = """
<mujoco><compiler angle="radian"/>
<option timestep="0.004" integrator="implicitfast"/><worldbody>
<body name="left"><joint name="shoulder" axis="0 0 1" damping="0.2" armature="0.01"/>
<inertial pos="0 0 0" mass="0.5" diaginertia="0.002 0.002 0.002"/></body>
<body name="right"><joint name="elbow" axis="0 0 1" damping="0.1" armature="0.01"/>
<inertial pos="0 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/></body>
</worldbody><actuator>
<position name="shoulder" joint="shoulder" kp="40" kv="2"/>
<position name="elbow" joint="elbow" kp="20" kv="1"/></actuator></mujoco>
"""
Hide = Callable[[mujoco.MjModel], None]
Act = Callable[[mujoco.MjModel, mujoco.MjData], None]


def commands(seed: int, seconds: float = 4.0) -> NDArray[np.float64]:
    """Return a sum of sines with a step every second, (frames, 2) [rad]."""
    random = np.random.default_rng(seed)
    time = np.arange(int(seconds * FPS)) / FPS
    waves = np.zeros((len(time), 2))
    for joint in range(2):
        for frequency in random.uniform(0.2, 1.5, 4):
            phase = random.uniform(0, 2 * np.pi)
            waves[:, joint] += 0.2 * np.sin(2 * np.pi * frequency * time + phase)
    steps = random.uniform(-0.3, 0.3, (int(seconds) + 1, 2))
    waves += steps[time.astype(int)]
    ramp = np.minimum(time / 0.3, 1.0)
    return waves * ramp[:, None]


def record(
    hide: Hide | None = None,
    act: Act | None = None,
    *,
    episodes: int = 6,
    noise: float = 4e-4,
    xml: str = TWO_LINKS,
    motion: Callable[[int], NDArray[np.float64]] = commands,
) -> Log:
    """Record an arm that was changed by `hide`, and by `act` before each step."""
    recordings = []
    for episode in range(episodes):
        model = mujoco.MjModel.from_xml_string(xml)
        if hide is not None:
            hide(model)
            mujoco.mj_setConst(model, mujoco.MjData(model))
        data = mujoco.MjData(model)
        sent = motion(episode)
        every = round(1 / FPS / model.opt.timestep)
        position, velocity = np.empty_like(sent), np.empty_like(sent)
        for frame, goal in enumerate(sent):
            position[frame], velocity[frame] = data.qpos, data.qvel
            for _ in range(every):
                data.ctrl[:] = goal
                if act is not None:
                    act(model, data)
                mujoco.mj_step(model, data)
        random = np.random.default_rng(100 + episode)
        told = position + random.normal(0, noise, position.shape)
        time = np.arange(len(sent)) / FPS
        recordings.append(Recording(f"episode {episode}", time, told, velocity, sent))
    names = ("shoulder", "elbow")
    return Log(tuple(recordings), names, names)
