"""Where the time of Stage II goes: physics, drawing, reading images, learning.

    uv run benchmarks/stage_two_parts.py num_envs=32 horizon=120

The variants of ``stage_two.py of=images`` in one process, with the functions that do a
part's work timed. What playing an iteration takes beside them is the rest: the policy's
head, TorchRL's own steps, observations, rewards, advantages.
"""

from __future__ import annotations

import importlib
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from stage_two import RECIPES, VARIANTS, Config, prepare

from rlco.collectors import RolloutCollector
from rlco.envs.tabletop_env import TabletopEnv
from rlco.physics.native.stepper import NativeStepper
from rlco.policies import ImageEncoder
from rlco.run import run_recipe
from rlco.training.learner import Learner

#: A part of an iteration, and the function that does its work.
TIMED: dict[str, tuple[type, str]] = {
    "collect": (RolloutCollector, "collect"),
    "physics": (NativeStepper, "step"),
    "drawing": (TabletopEnv, "_render"),
    "reading images": (ImageEncoder, "forward"),
    "learning": (Learner, "update"),
}


class Clock:
    """Seconds by part, one entry an iteration."""

    def __init__(self) -> None:
        self.iterations: list[dict[str, float]] = []
        self._playing = False

    def timed(self, part: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the same and is timed.

        Parts of playing count while a rollout is played: learning and evaluations
        read images, too.
        """

        def run(*args: Any, **kwargs: Any) -> Any:
            whole = part in ("collect", "learning")
            if part == "collect":
                self.iterations.append(defaultdict(float))
                self._playing = True
            began = time.perf_counter()
            done = work(*args, **kwargs)
            if whole or self._playing:
                self.iterations[-1][part] += time.perf_counter() - began
            if part == "collect":
                self._playing = False
            return done

        return run


@contextmanager
def timing() -> Iterator[Clock]:
    """Time the functions of each part."""
    clock = Clock()
    patches = [
        mock.patch.object(kind, name, clock.timed(part, getattr(kind, name)))
        for part, (kind, name) in TIMED.items()
    ]
    for patch in patches:
        patch.start()
    try:
        yield clock
    finally:
        mock.patch.stopall()


def main(config: Config) -> None:
    """Measure and print."""
    sys.path.insert(0, str(RECIPES))
    rl_co: Any = importlib.import_module("rl_co")
    size = [f"num_envs={config.num_envs}", f"horizon={config.horizon}"]
    size += [f"iterations={config.iterations + 1}", "eval_episodes=0"]
    parts = [part for part in TIMED if part not in ("collect", "learning")]
    lines = [f"| | {' | '.join(parts)} | rest of playing | learning |"]
    lines.append("|---" * (len(parts) + 3) + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given = {
            images: prepare(config, folder / f"images_{images}", images=images)
            for images in (False, True)
        }
        for number, (one, (options, images)) in enumerate(VARIANTS["images"].items()):
            out = f"out={folder / str(number)}"
            with timing() as clock:
                run_recipe(
                    rl_co.main, rl_co.Config, [*given[images], *options, *size, out]
                )
            # The first one compiles kernels and fills caches.
            counted = clock.iterations[1:]
            seconds = {
                part: statistics.median(row[part] for row in counted) for part in TIMED
            }
            rest = seconds["collect"] - sum(seconds[part] for part in parts)
            cells = [*(seconds[part] for part in parts), rest, seconds["learning"]]
            lines.append(f"| {one} | {' | '.join(f'{cell:.2f}' for cell in cells)} |")
    print("\n".join(lines))


if __name__ == "__main__":
    run_recipe(main, Config)
