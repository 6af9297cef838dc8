"""Runs of a servo on a pendulum, by a loop that shares no code with the library."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rlco.gap.logs.log import Array

STEP, MASS, LENGTH, VOLTS = 0.005, 0.49, 0.1, 7.4
STEPS_A_TURN = 4096
# Of the servo that plays: none is as published.
STALL, BACK_EMF = 0.6, 0.03
ARMATURE, DAMPING, FRICTION, ZERO = 0.002, 0.015, 0.012, 0.03
# Steps a turn, in 256ths, of a largest duty of 885.
DUTY_GAIN = 4096.0 / (2.0 * math.pi) / (256.0 * 885.0)


def goals(kind: str, seconds: float = 3.0) -> Array:
    """Goals of a motion, one a step."""
    time = np.arange(0.0, seconds, STEP)
    if kind == "steps":
        return np.asarray(1.4 * np.sign(np.sin(2.5 * time)) * (time > 0.3))
    return np.asarray(1.2 * np.sin(4.0 * time) + 0.5 * np.sin(11.0 * time))


def play(
    sent: Array, kp: float, *, ratio: float = 0.0, loss: float = 0.0
) -> tuple[Array, Array]:
    """Return what the encoder reports and the duty of each step.

    Args:
        sent: Goals, one a step.
        kp: The firmware's gain.
        ratio: Of a friction in proportion to the load.
        loss: Of the drive's torque [1/(N m)].
    """
    inertia = MASS * LENGTH**2 + ARMATURE
    angle, speed = 0.0, 0.0
    told, duties = np.empty_like(sent), np.empty_like(sent)
    for row, goal in enumerate(sent):
        told[row] = angle + ZERO
        duty = max(-1.0, min(1.0, DUTY_GAIN * kp * (goal - told[row])))
        duties[row] = duty
        torque = duty * STALL - BACK_EMF * speed
        torque /= 1.0 + loss * abs(torque)
        weight = MASS * 9.81 * LENGTH * math.sin(angle)
        holds = STEP * (FRICTION + ratio * abs(torque + weight))
        momentum = inertia * speed + STEP * (torque - weight)
        slowed = math.copysign(max(abs(momentum) - holds, 0.0), momentum)
        speed = slowed / (inertia + STEP * DAMPING)
        angle += STEP * speed
    return told, duties


def write_run(
    folder: Path,
    name: str,
    kp: float,
    kind: str,
    *,
    ratio: float = 0.0,
    loss: float = 0.0,
    sag: float = 0.0,
    motor: str = "xl330",
    seconds: float = 3.0,
) -> Path:
    """Write one run as BAM's JSON; its volts fall by `sag` at full duty."""
    sent = goals(kind, seconds)
    told, duties = play(sent, kp, ratio=ratio, loss=loss)
    turn = 2.0 * math.pi / STEPS_A_TURN
    entries = [
        {
            "timestamp": STEP * row,
            "position": turn * round(float(angle) / turn),
            "goal_position": float(goal),
            "torque_enable": True,
            "input_volts": VOLTS - sag * abs(float(duty)),
        }
        for row, (angle, goal, duty) in enumerate(zip(told, sent, duties, strict=True))
    ]
    header = {"mass": MASS, "length": LENGTH, "vin": VOLTS, "kp": kp, "motor": motor}
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.json"
    file.write_text(json.dumps({**header, "trajectory": kind, "entries": entries}))
    return file


def write_bench(
    folder: Path,
    *,
    gains: Sequence[float] = (100.0, 300.0, 800.0),
    ratio: float = 0.0,
    loss: float = 0.0,
    sag: float = 0.0,
) -> Path:
    """Write two motions under each of some gains; return the folder."""
    for kp in gains:
        for kind in ("steps", "sines"):
            name = f"{kind}_{kp:g}"
            write_run(folder, name, kp, kind, ratio=ratio, loss=loss, sag=sag)
    return folder
