"""Success of a policy over paired initial states."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.envs.batched_envs import BatchedEnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from rlco import keys
from rlco.envs import check_action_units, make_env
from rlco.envs.chunk_env import ChunkEnv
from rlco.errors import ConfigError
from rlco.physics.spec.domain import (
    FINAL_DOMAINS,
    Domain,
    GivenDomain,
    drawing,
    make_domain,
)
from rlco.physics.tasks.named_task import check_domains
from rlco.reporting.statistics import ResultRow, wilson_interval

log = logging.getLogger("rlco.evaluation")

# Initial states of evaluations come from seeds that no training reaches.
EVALUATION_SEED = 1_000_003


def final_states_seed(seed: int) -> int:
    """Return the seed of the initial states that final evaluations of a run start from.

    They differ from those of learning curves, so that a policy that was chosen by its
    curve is counted anew; and all methods of a seed share them, whichever recipe
    evaluates.

    Args:
        seed: Of the run.

    Example:
        >>> final_states_seed(0) - EVALUATION_SEED
        1
    """
    return EVALUATION_SEED + 1 + seed


@dataclass(frozen=True)
class Evaluation:
    """What M episodes of a policy came to, in the order of their initial states.

    Attributes:
        success: Whether the task was solved at the episode's end, bool, shape (M,).
        seconds: Time until it was solved for good [s]; NaN where it was not.
        ever: Whether it was solved after at least one decision, bool, shape (M,).
        states_seed: Seed of the initial states; None where it is not known.
    """

    success: NDArray[np.bool_]
    seconds: NDArray[np.float64]
    ever: NDArray[np.bool_]
    states_seed: int | None = None

    @property
    def rate(self) -> float:
        """Share of episodes that were solved at their end."""
        return float(self.success.mean())

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Whether the task was solved, but not at the episode's end, shape (M,)."""
        return self.ever & ~self.success

    def row(
        self,
        method: str,
        domain: str,
        seed: int,
        *,
        task: str,
        policy: str,
        variation: str | None = None,
    ) -> ResultRow:
        """Return this evaluation as a row of results.json."""
        row = ResultRow(
            method=method,
            task=task,
            policy=policy,
            domain=domain,
            variation=variation,
            seed=seed,
            episodes=int(self.success.size),
            successes=int(self.success.sum()),
            ever_successes=int(self.ever.sum()),
            lost=int(self.lost.sum()),
            outcomes=self.success.astype(int).tolist(),
            ever=self.ever.astype(int).tolist(),
        )
        if self.states_seed is not None:
            row["states_seed"] = self.states_seed
        return row

    def __str__(self) -> str:
        low, high = wilson_interval(int(self.success.sum()), self.success.size)[1:]
        solved = self.seconds[self.success]
        share = f"{self.rate:.1%} [{low:.1%}, {high:.1%}]"
        text = f"{share} of {self.success.size} episodes"
        if solved.size:
            text += f", in {np.median(solved):.1f} s"
        return f"{text}; {self.reached()}"

    def reached(self) -> str:
        """Return in words what success at the end leaves out."""
        return f"ever {self.ever.mean():.1%}, lost again {self.lost.mean():.1%}"


def evaluate(policy: Any, env: ChunkEnv, episodes: int) -> Evaluation:
    """Play the first `episodes` episodes of an environment's seed, without noise.

    The initial states depend on the seed alone, so two policies, and two domains,
    see the same ones: their difference is a paired one. Whether the task is solved is
    read at the end of each decision: "ever" misses what is undone within a chunk.

    Args:
        policy: Writes `action`; its most likely action is taken.
        env: Where to play, of `make_env`; its batch is filled as often as needed.
        episodes: M.

    Raises:
        ConfigError: The environment cannot start the episodes of its seed again.
        RlcoError: The policy acts in other units than the environment takes.
    """
    _check_played(policy, env)
    decisions = -(-env.horizon // env.chunk)
    (count,) = env.batch_size
    period = env.chunk / env.task.control_frequency
    limit = env.horizon / env.task.control_frequency
    success, seconds, ever = [], [], []
    batches = tqdm(range(-(-episodes // count)), "evaluate", leave=False, disable=None)
    for index in batches:
        env.start_at(index)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            rollout = env.rollout(decisions, policy)
        solved = rollout["next", keys.SUCCESS].squeeze(-1).numpy()
        # Decisions after the last unsolved one: solved for good from there on.
        trailing = np.cumprod(solved[:, ::-1], axis=1).sum(axis=1)
        # The last decision of an episode may be cut short.
        time = np.minimum((decisions - trailing + 1) * period, limit)
        success.append(solved[:, -1])
        seconds.append(np.where(solved[:, -1], time, np.nan))
        ever.append(solved.any(axis=1))
        batches.set_postfix_str(f"success {np.concatenate(success).mean():.1%}")
    return Evaluation(
        np.concatenate(success)[:episodes],
        np.concatenate(seconds)[:episodes],
        np.concatenate(ever)[:episodes],
        env.states_seed,
    )


def _check_played(policy: Any, env: Any) -> None:
    # Asked of a batched environment that is not started, hasattr never returns.
    if isinstance(env, BatchedEnvBase) or not hasattr(env, "start_at"):
        raise ConfigError(
            [
                "evaluate plays the first episodes of a seed, in environments of "
                f"rlco.envs.make_env, and {type(env).__name__} cannot start them "
                "again; play it with env.rollout(steps, policy) and read 'success'"
            ]
        )
    check_action_units(policy, env)


def final_rows(
    policy: Any,
    domains: Mapping[str, Domain],
    episodes: int,
    *,
    method: str,
    task: str,
    seed: int,
) -> list[ResultRow]:
    """Count a run's policy in each domain; return rows of results.json.

    The initial states are those of `final_states_seed`, so rows of several recipes
    and one seed can be compared in pairs.

    Args:
        policy: See `evaluate`; has ``chunk``, ``image_size``, ``renderer`` and
            ``kind``.
        domains: By their names.
        episodes: In each; 0: no rows.
        method: What the rows call it.
        task: The task's name.
        seed: Of the run.
    """
    if not episodes:
        return []
    envs = evaluation_envs(
        task,
        domains,
        chunk=policy.chunk,
        episodes=episodes,
        **read_by(policy),
        seed=final_states_seed(seed),
    )
    rows = []
    for domain, env in envs.items():
        result = evaluate(policy, env, episodes)
        log.info("%s in %s: %s", method, domain, result)
        rows.append(result.row(method, domain, seed, task=task, policy=policy.kind))
    return rows


def success_rates(
    policy: Any,
    envs: Mapping[str, ChunkEnv],
    episodes: int,
    iteration: int | None = None,
) -> dict[str, float]:
    """Return ``success_<domain>`` of a policy in each domain's environment.

    Training goes on as if nothing had been measured, whatever the policy draws.

    Args:
        policy: See `evaluate`.
        envs: The environment of each domain, by the domain's name.
        episodes: Of each.
        iteration: When this is measured: then it is logged too.
    """
    rates = {}
    for domain, env in envs.items():
        with torch.random.fork_rng():
            result = evaluate(policy, env, episodes)
        rates[f"success_{domain}"] = result.rate
        if iteration is not None:
            log.info(
                "rollout %d in %s: %.1f%%; %s",
                iteration,
                domain,
                100 * result.rate,
                result.reached(),
            )
    return rates


def evaluation_domains(
    task: str,
    evaluated: Iterable[str],
    *,
    train_domain: str | None = None,
    train_sample: str = "none",
) -> dict[str, Domain]:
    """Return the domains to evaluate in by their names, all checked for the task.

    Args:
        task: The task's name.
        evaluated: Names, or paths of effects.yaml files.
        train_domain: The same, of where training takes place, if it does.
        train_sample: ``posterior`` where its episodes draw parameter sets.

    Raises:
        ConfigError: A file's name cannot name a column of metrics.csv, or training
            would take place in a domain for final evaluations.
        RlcoError: See `rlco.physics.tasks.named_task.check_domains`.
    """
    given = list(evaluated)
    if train_domain is not None and make_domain(train_domain).name in FINAL_DOMAINS:
        raise ConfigError(
            [
                f"train_domain={train_domain!r} is for final evaluations alone, and "
                "would say nothing once something was trained in it; train in sim, "
                "stand_in, or a domain of your own"
            ]
        )
    if train_domain is not None and train_sample == "posterior":
        drawing(make_domain(train_domain), "posterior")
    check_domains(task, [*given, *([] if train_domain is None else [train_domain])])
    domains = {domain.name: domain for domain in map(make_domain, given)}
    problems = [
        f"domain {name!r} cannot name a column of metrics.csv; rename its file, "
        "without commas and quotes"
        for name in domains
        if set(name) & set(',"\r\n')
    ]
    if problems:
        raise ConfigError(problems)
    return domains


def evaluation_envs(
    task: str, domains: Mapping[str, Domain], **options: Any
) -> dict[str, ChunkEnv]:
    """Return `evaluation_env` of each domain, by the domain's name."""
    return {
        name: evaluation_env(task, domain, **options)
        for name, domain in domains.items()
    }


def read_by(policy: Any, renderer: str | None = None) -> dict[str, Any]:
    """Return the options of `make_env` for the images that a policy reads.

    Args:
        policy: Has ``image_size``, None where it reads none, and may have ``renderer``
            and ``cameras``.
        renderer: What is to draw them; None: what the policy was trained with.

    Example:
        >>> from rlco.policies import GaussianPolicy
        >>> image = {"kind": "conv", "size": (64, 64)}
        >>> read_by(GaussianPolicy(7, chunk=4, image=image))
        {'image_size': (64, 64), 'renderer': 'opengl', 'cameras': ('agentview',)}
    """
    size = getattr(policy, "image_size", None)
    if size is None:
        return {"image_size": None}
    trained = getattr(policy, "renderer", "opengl")
    cameras = getattr(policy, "cameras", ("agentview",))
    return {"image_size": size, "renderer": renderer or trained, "cameras": cameras}


def evaluation_env(
    task: str, domain: GivenDomain, *, chunk: int, episodes: int, **options: Any
) -> ChunkEnv:
    """Return the environment that evaluations share, at most 64 episodes at once."""
    # A diverged episode is neither a success nor a failure.
    options = {"seed": EVALUATION_SEED, "on_divergence": "raise", **options}
    return make_env(
        task, domain=domain, num_envs=min(episodes, 64), chunk=chunk, **options
    )
