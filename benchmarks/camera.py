"""Milliseconds a frame takes by robosuite's own renderer and by both our qualities.

Run ``python benchmarks/camera.py [rounds]`` with OMP_NUM_THREADS=1; it prints one
markdown table. Every side draws the same states of push_cube. The sides take turns, so
that what else the machine does meets all: a time is the median over rounds, a ratio the
median of the rounds' ratios. MuJoCo loads one OpenGL library in a process, so each has
a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

LIBRARIES = ("osmesa", "egl")
SIZES = (64, 128, 224)


def sides(size: int) -> dict[str, Callable[[], Any]]:
    """Return what draws one frame of the same scene, each side under its name."""
    from rlco.physics.rendering.camera import Camera
    from rlco.physics.tasks.plain_robosuite import make_robosuite

    env = make_robosuite("push_cube", image_size=(size, size))
    for _ in range(5):
        env.step(np.array([0.5, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0]))
    model, data = env.sim.model._model, env.sim.data._data
    exact = Camera(model, (size, size), quality="robosuite")
    fast = Camera(model, (size, size), quality="fast")

    def own() -> Any:
        return env.sim.render(width=size, height=size, camera_name="agentview")

    return {
        "robosuite": own,
        "`robosuite`": lambda: exact.frame(data),
        "`fast`": lambda: fast.frame(data),
    }


def measure(library: str, rounds: int) -> None:
    """Print one line a size."""
    for size in SIZES:
        draw = sides(size)
        seconds = np.empty((rounds + 1, len(draw)))
        for row in seconds:
            for column, frame in enumerate(draw.values()):
                began = time.perf_counter()
                frame()
                row[column] = time.perf_counter() - began
        seconds = seconds[1:]  # shaders are compiled in the first
        own, exact, fast = 1e3 * np.median(seconds, axis=0)
        ratios = np.percentile(seconds[:, 0] / seconds[:, 2], [25, 50, 75])
        low, middle, high = ratios
        print(
            f"| {library} | {size} x {size} | {own:.1f} | {exact:.1f} | {fast:.1f} "
            f"| {middle:.1f} [{low:.1f}, {high:.1f}] |",
            flush=True,
        )


def main(rounds: int) -> None:
    """Measure with each library, and print the table."""
    print(
        "| MUJOCO_GL | frame | robosuite's own [ms] | `robosuite` [ms] | `fast` [ms] "
        "| own / `fast` [quartiles] |"
    )
    print("|---|---|---|---|---|---|", flush=True)
    for library in LIBRARIES:
        subprocess.run(
            [sys.executable, __file__, str(rounds), library],
            env={**os.environ, "MUJOCO_GL": library},
            check=True,
        )


if __name__ == "__main__":
    given = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    if len(sys.argv) > 2:
        measure(sys.argv[2], given)
    else:
        main(given)
