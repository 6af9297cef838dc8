"""What frames cost by rlco's own renderer and by OpenGL, alone and in a rollout.

Run ``python benchmarks/raster.py [rounds]`` with OMP_NUM_THREADS=1; it prints two
markdown tables. Both renderers draw the same states of push_cube and take turns. Times
are processor time of all threads [ms]: what else the machine does adds little to them,
and software OpenGL (Mesa's llvmpipe) draws in threads of its own. Speed on two threads
is that of the clock, and needs two processors that do nothing else; next to it stands
what two threads add to the processor time of a frame, which bounds it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "1")

import numpy as np
import torch

from rlco.envs import make_env
from rlco.physics.rendering.camera import Camera
from rlco.physics.rendering.raster import RasterCamera

SIZES = (64, 128)
CAMERAS = ("agentview", "robot0_eye_in_hand")
EPISODES = 128
WORLDS = 32


def costs(work: Callable[[], Any]) -> tuple[float, float]:
    """Return processor time and time [s]."""
    began = time.process_time(), time.perf_counter()
    work()
    return time.process_time() - began[0], time.perf_counter() - began[1]


def states(threads: int) -> Any:
    """Return a stepper of push_cube's worlds in the middle of episodes."""
    env = make_env("push_cube", num_envs=WORLDS, chunk=4, seed=1, threads=threads)
    torch.manual_seed(0)
    env.rollout(5)
    return env.stepper


def alone(name: str, size: int, rounds: int) -> str:
    """Return a line of the table of frames."""
    one, two = states(1), states(2)
    camera = Camera(one.model, (size, size), name)
    raster = [
        RasterCamera(s.model, (size, size), name, num_envs=WORLDS) for s in (one, two)
    ]
    sources = [
        r.sources(s.model_addresses, s.data)
        for r, s in zip(raster, (one, two), strict=True)
    ]
    images = np.zeros((WORLDS, 3, size, size), np.uint8)
    which = np.arange(WORLDS)

    def own(threads: int) -> Callable[[], None]:
        r, s = raster[threads - 1], (one, two)[threads - 1]
        return lambda: r.draw(sources[threads - 1], which, images, s.run_over)

    def opengl() -> None:
        for world in range(WORLDS):
            camera.frame(one.data[world])

    sides = (own(1), own(2), opengl)
    for side in sides:
        side()
    spent = np.array([[costs(side) for side in sides] for _ in range(rounds)])
    spent *= 1e3 / WORLDS
    single, double, gl = np.median(spent[..., 0], axis=0)
    ratio = np.percentile(spent[:, 2, 0] / spent[:, 0, 0], [25, 50, 75])
    speed = np.median(spent[:, 0, 1] / spent[:, 1, 1])
    return (
        f"| {name}, {size} x {size} | {gl:.2f} | {single:.3f} | {ratio[1]:.1f} "
        f"[{ratio[0]:.1f}, {ratio[2]:.1f}] | {speed:.2f} | {double / single:.2f} |"
    )


def rollouts(rounds: int) -> None:
    """Print the table of rollouts."""
    print("\n| images | processor [s] | clock [s] | processor, ratio [quartiles] |")
    print("|---|---|---|---|", flush=True)
    kinds: dict[str, dict[str, Any]] = {
        "none": {},
        "raster, 64 x 64": {"image_size": (64, 64), "renderer": "raster"},
        "raster, 64 x 64, and the wrist camera": {
            "image_size": (64, 64),
            "renderer": "raster",
            "cameras": CAMERAS,
        },
        "raster, 128 x 128": {"image_size": (128, 128), "renderer": "raster"},
        "opengl, 64 x 64": {"image_size": (64, 64), "renderer": "opengl"},
    }
    envs = {
        name: make_env("push_cube", num_envs=EPISODES, chunk=4, seed=1, **options)
        for name, options in kinds.items()
    }
    spent = []
    for _ in range(rounds):
        row = []
        for env in envs.values():
            torch.manual_seed(0)
            row.append(costs(partial(env.rollout, 16)))
        spent.append(row)
    found = np.array(spent[1:])  # the first compiles, and fills caches
    for number, name in enumerate(kinds):
        cpu, clock = np.median(found[:, number], axis=0)
        ratio = np.percentile(found[:, number, 0] / found[:, 0, 0], [25, 50, 75])
        print(
            f"| {name} | {cpu:.2f} | {clock:.2f} | {ratio[1]:.2f} "
            f"[{ratio[0]:.2f}, {ratio[2]:.2f}] |"
        )


def main(rounds: int) -> None:
    """Measure, and print both tables."""
    print(
        "| frame | `fast`, OpenGL [ms] | `raster` [ms] | OpenGL / raster [quartiles] "
        "| two threads, speed | two threads, processor time |"
    )
    print("|---|---|---|---|---|---|", flush=True)
    for name in CAMERAS:
        for size in SIZES:
            print(alone(name, size, rounds), flush=True)
    rollouts(max(3, rounds // 4))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 24)
