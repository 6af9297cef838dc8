"""What the arithmetic of docs/scale.md is made of: a rollout's parts, on one core.

    OMP_NUM_THREADS=1 uv run benchmarks/scale_parts.py
    OMP_NUM_THREADS=1 uv run benchmarks/scale_parts.py iterations=40 seed=1

Records a few demonstrations, trains Stage I for a moment, then runs recipes/rl_co.py as
its defaults have it, but for the first rollouts, which do not train the critic alone:
the policy learns from each. Times are of the processor, not of the clock, so that other
processes of the machine count little. Prints them, the sizes of what is sent between
processes, and by what code on which machine it was measured.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stage_two import RECIPES, prepare
from stage_two import Config as Small

from rlco.collectors import RolloutCollector
from rlco.collectors.local_rollouts import LocalRollouts
from rlco.run import run_recipe
from rlco.runs.config import option, parse
from rlco.runs.run_folder import commit, processor
from rlco.training.learner import Learner


@dataclass
class Config:
    """Options of scale_parts.py."""

    task: str = option("push_cube", "name of the task")
    iterations: int = option(14, "rollouts; the first two are not counted", minimum=3)
    seed: int = option(0, "of the training")


@dataclass
class Watched:
    """Processor time of each rollout and of each update [s], and what was played."""

    collect: list[float] = field(default_factory=list)
    learn: list[float] = field(default_factory=list)
    sent: Any = None
    learner: Any = None


@contextmanager
def watched() -> Iterator[Watched]:
    """Note what each rollout and each update takes."""
    found = Watched()

    def played(one: RolloutCollector, iteration: int) -> Any:
        return _timed(found.collect, lambda: collect(one, iteration))

    def learned(one: Learner, *given: Any, **named: Any) -> Any:
        found.learner = one
        return _timed(found.learn, lambda: update(one, *given, **named))

    def seen(one: LocalRollouts, iteration: int) -> Any:
        found.sent = play(one, iteration)
        return found.sent

    collect, update, play = RolloutCollector.collect, Learner.update, LocalRollouts.play
    owners: Any = (RolloutCollector, Learner, LocalRollouts)
    names = ("collect", "update", "play")
    for owner, name, watch in zip(owners, names, (played, learned, seen), strict=True):
        setattr(owner, name, watch)
    try:
        yield found
    finally:
        for owner, name, was in zip(
            owners, names, (collect, update, play), strict=True
        ):
            setattr(owner, name, was)


def _timed(seconds: list[float], work: Callable[[], Any]) -> Any:
    began = time.process_time()
    out = work()
    seconds.append(time.process_time() - began)
    return out


def size(modules: list[Any]) -> int:
    """Return the bytes of modules' weights and buffers."""
    return sum(v.nbytes for one in modules for v in one.state_dict().values())


def spread(values: np.ndarray[Any, Any], unit: str = "") -> str:
    """Return the median, and the quartiles."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.3g}{unit} (quartiles {low:.3g} to {high:.3g})"


def measure(config: Config) -> Watched:
    """Run Stage II, and return what it took."""
    sys.path.insert(0, str(RECIPES))
    rl_co: Any = importlib.import_module("rl_co")
    with tempfile.TemporaryDirectory() as name, watched() as found:
        given = prepare(Small(task=config.task), Path(name))
        given += [
            f"iterations={config.iterations}",
            f"seed={config.seed}",
            "horizon=64",
        ]
        given += ["critic_iterations=0", "eval_episodes=0", "final_episodes=0"]
        rl_co.main(parse(rl_co.Config, [*given, f"out={name}/run"], rl_co.__file__))
    return found


def main(config: Config) -> None:
    """Measure and print."""
    found = measure(config)
    collect, learn = (np.array(one[2:]) for one in (found.collect, found.learn))
    sent, learner = found.sent, found.learner
    steps = sent.numel() * learner.policy.chunk
    trained = [learner.policy, learner.critic]
    rows = {
        "playing, processor": spread(collect, " s"),
        "learning, processor": spread(learn, " s"),
        "control steps a second and core": spread(steps / collect),
        "playing over learning": spread(collect / learn),
        "a decision, as a worker sends it": f"{sent.bytes() // sent.numel()} bytes",
        "the policy": f"{size([learner.policy]) / 1e3:.0f} kB",
        "trained weights": sum(p.numel() for one in trained for p in one.parameters()),
        "rollouts counted": f"{len(collect)}, seed {config.seed}",
        "code": commit(RECIPES),
        "machine": f"{processor()}, {os.cpu_count()} cores, torch {torch.__version__}",
        "its load": f"{os.getloadavg()[0]:.0f}",
    }
    print(f"| part | {config.task}, {steps} control steps a rollout |\n|---|---|")
    for name, value in rows.items():
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    run_recipe(main, Config)
