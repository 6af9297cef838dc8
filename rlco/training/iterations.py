"""The loop of Stage II: rollout, update, what they amount to, checkpoint."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Protocol

from rlco import keys
from rlco.training.distributed.ranks import Ranks

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from rlco.training.kept_policy import BestPolicy
    from rlco.training.learner import Learner
    from rlco.training.run_protocols import Collector, TrainingRun

log = logging.getLogger("rlco.training")

Row = dict[str, Any]
#: What a rollout is judged by.
_PLAYED = (
    keys.ADVANTAGE,
    *(("next", key) for key in (keys.REWARD, keys.SUCCESS, keys.DIVERGED)),
)


class LoopOptions(Protocol):
    """Options of the loop itself.

    Attributes:
        iterations: Rollouts.
        epochs: Passes over each.
        critic_iterations: First rollouts that train the critic alone.
    """

    iterations: int
    epochs: int
    critic_iterations: int


def co_train(
    options: LoopOptions,
    run: TrainingRun,
    collector: Collector,
    learner: Learner,
    *,
    check_first: Callable[[TensorDictBase], None],
    best: BestPolicy | None = None,
    measure: Callable[[int], bool] = lambda iteration: False,
    ranks: Ranks | None = None,
) -> Iterator[tuple[int, Row]]:
    """Collect and learn, and yield the row of metrics.csv of each iteration.

    The body of the loop adds to the row what it measures. Then the row is written, and
    last a checkpoint is saved. A resumed run goes on after its last checkpoint.

    Args:
        options: How often.
        run: Counts the iterations, and keeps rows and checkpoints.
        collector: Plays the rollouts.
        learner: Learns from them.
        check_first: Checks the first rollout before anything is learned from it.
        measure: In which iterations the anchor is compared with PPO's mean gradient.
        best: Is offered each row and lies in each checkpoint, where there is one.
        ranks: The processes that learn together, all of which run this loop; None: this
            one alone. Rows and checks are of the rollouts of all.

    Yields:
        The iteration, counted from 1, and its row: frames so far, return and success
        of the rollout, and what the learner reports.
    """
    ranks = Ranks() if ranks is None else ranks
    if (saved := ranks.from_lead(run.load_checkpoint())) is not None:
        learner.load(saved)
        if best is not None:
            best.load(saved["best"])
    alone = options.critic_iterations if learner.critic is not None else 0
    if alone >= options.iterations and ranks.leads:
        log.warning(
            "the critic alone is trained in the first %d rollouts (critic_iterations), "
            "and there are %d (iterations): the policy stays as it was given",
            alone,
            options.iterations,
        )
    for iteration in run.iterations(options.iterations):
        started = time.perf_counter()
        learner.draw_own(iteration)
        learner.anneal((iteration - 1) / options.iterations)
        rollout = collector.collect(iteration)
        collected = time.perf_counter()
        played = ranks.joined(rollout.select(*_PLAYED, strict=False))
        if iteration == 1:
            check_first(played)
        frames = collector.frames * ranks.count
        row = {"frames": iteration * frames, **_played(played)}
        # Every minibatch of every epoch draws its real rows anew.
        row |= learner.update(
            rollout,
            options.epochs,
            train_policy=iteration > alone,
            measure=measure(iteration),
        )
        learned = time.perf_counter()
        yield iteration, row
        run.log_metrics(iteration, row)
        run.log_timings(
            iteration,
            {
                "collect": collected - started,
                "learn": learned - collected,
                "evaluate": time.perf_counter() - learned,
                "frames_per_second": frames / (learned - started),
            },
        )
        state = learner.state()
        if best is not None:
            best.offer(iteration, row)
            state["best"] = best.state()
        run.save_checkpoint(iteration, state)


def _played(rollout: TensorDictBase) -> Row:
    """Return what the episodes of a rollout came to."""
    solved = rollout["next", keys.SUCCESS][:, -1]
    return {
        "return_mean": float(rollout["next", keys.REWARD].sum(1).mean()),
        "success_rollout": float(solved.float().mean()),
        "diverged": int(rollout["next", keys.DIVERGED].sum()),
    }
