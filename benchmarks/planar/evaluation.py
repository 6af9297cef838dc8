"""Success of policies in the planar task, in the simulator and in `stand_in`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.envs.utils import ExplorationType, set_exploration_type

from planar.env import PlanarEnv, PlanarTask
from planar.gaps import SIM, named_gap
from rlco import keys
from rlco.evaluation import EVALUATION_SEED

#: Where policies are evaluated; `stand_in` plays the robot's part, with the gap's
#: differences. No robot moves.
DOMAINS = ("sim", "stand_in")


@dataclass(frozen=True)
class Outcome:
    """What M episodes of a policy came to, in the order of their starts.

    Attributes:
        end: Whether each was solved at its end, shape (M,).
        ever: Whether it was solved after any decision, shape (M,).
    """

    end: NDArray[np.bool_]
    ever: NDArray[np.bool_]

    def row(self, method: str, domain: str, gap: str, seed: int) -> dict[str, Any]:
        """Return this as a row of results.json."""
        return {
            "method": method,
            "task": PlanarTask.name,
            "policy": "gaussian",
            "domain": domain,
            "variation": None,
            "gap": gap,
            "seed": seed,
            "episodes": int(self.end.size),
            "successes": int(self.end.sum()),
            "ever_successes": int(self.ever.sum()),
            "lost": int((self.ever & ~self.end).sum()),
            "outcomes": self.end.astype(int).tolist(),
            "ever": self.ever.astype(int).tolist(),
            "states_seed": EVALUATION_SEED,
        }


def evaluation_envs(gap: str, episodes: int) -> dict[str, PlanarEnv]:
    """Return where policies are evaluated: the same starts in both domains."""
    gaps = dict(zip(DOMAINS, (SIM, named_gap(gap)), strict=True))
    return {
        name: PlanarEnv(one, num_envs=episodes, seed=EVALUATION_SEED)
        for name, one in gaps.items()
    }


def play(policy: Any, env: PlanarEnv) -> Outcome:
    """Play the first episode of every plane, without exploration."""
    env.start_at(0)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(-(-env.horizon // env.chunk), policy)
    solved = rollout["next", keys.SUCCESS].squeeze(-1).numpy()
    return Outcome(solved[:, -1], solved.any(axis=1))


def play_all(policy: Any, envs: Mapping[str, PlanarEnv]) -> dict[str, Outcome]:
    """Return the outcome in each domain."""
    return {name: play(policy, env) for name, env in envs.items()}


def rates(outcomes: Mapping[str, Outcome]) -> dict[str, float]:
    """Return columns of metrics.csv: ``success_DOMAIN`` and ``ever_DOMAIN``."""
    found = {}
    for name, outcome in outcomes.items():
        found[f"success_{name}"] = float(outcome.end.mean())
        found[f"ever_{name}"] = float(outcome.ever.mean())
    return found
