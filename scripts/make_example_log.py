"""Make docs/example: a small arm's model, and a log of the "robot" it lacks.

    uv run scripts/make_example_log.py

The robot is simulated, and no line of rlco takes part: its joint positions lag behind
their commands by 36 ms, it carries 0.35 kg at its tip that the model knows nothing of,
and its encoders add noise. `find_gap` is to find the first two.
"""

from __future__ import annotations

import csv
from pathlib import Path

import mujoco
import numpy as np

FOLDER = Path(__file__).parents[1] / "docs" / "example"
JOINTS = ("base", "shoulder", "elbow")
DELAY, PAYLOAD, NOISE = 0.036, 0.35, 3e-4  # [s], [kg], [rad]
SECONDS, RATE = 12.0, 50  # of one recording [s], of its rows [Hz]
SEEDS = (1, 2, 3)


def main() -> None:
    """Record three motions."""
    spec = mujoco.MjSpec.from_file(str(FOLDER / "arm.xml"))
    spec.body("forearm").add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], pos=[0.3, 0, 0],
        mass=PAYLOAD,
    )  # fmt: skip
    model = spec.compile()
    logs = FOLDER / "logs"
    logs.mkdir(exist_ok=True)
    for seed in SEEDS:
        rows = record(model, np.random.default_rng(seed))
        with (logs / f"run{seed}.csv").open("w", newline="") as file:
            table = csv.writer(file)
            names = [f"{kind}_{j}" for kind in ("command", "position") for j in JOINTS]
            table.writerow(["time", *names])
            table.writerows([f"{value:.5g}" for value in row] for row in rows)


def record(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    """Return rows of time, commands and positions, shape (T, 1 + 2 * joints)."""
    data = mujoco.MjData(model)
    step = model.opt.timestep
    times = np.arange(round(SECONDS / step)) * step
    target = commands(times, rng)
    data.qpos = target[0]
    late, every = round(DELAY / step), round(1 / (RATE * step))
    rows = []
    for i, time in enumerate(times):
        if i % every == 0:
            sent = target[i]
            seen = data.qpos + NOISE * rng.standard_normal(len(JOINTS))
            rows.append([time, *sent, *seen])
        # A command holds until the next row, and arrives late.
        data.ctrl = target[max(0, (i - late) // every * every)]
        mujoco.mj_step(model, data)
    return np.array(rows)


def commands(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return smooth motion that pauses at times, shape (T, joints) [rad]."""
    waves = np.zeros((len(times), len(JOINTS)))
    for joint in range(len(JOINTS)):
        for _ in range(4):
            size, rate = rng.uniform(0.1, 0.4), rng.uniform(0.1, 0.9)
            phase = rng.uniform(0, 2 * np.pi)
            waves[:, joint] += size * np.sin(2 * np.pi * rate * times + phase)
    # Time runs, rests for a second in every four, and runs on.
    clock = np.cumsum(np.mod(times, 4.0) < 3.0) * (times[1] - times[0])
    return np.stack([np.interp(clock, times, wave) for wave in waves.T], axis=1)


if __name__ == "__main__":
    main()
