"""Demonstrations by a task's scripted expert."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.files.indices import format_indices
from rlco.physics.effects.corrected_model import Given
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import Domain, GivenDomain, make_domain
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.robot import POSITION
from rlco.physics.spec.task import Array, Task
from rlco.physics.tasks.check_task import check_task

_logger = logging.getLogger(__name__)

#: Episodes after which an expert is judged.
MANY = 40
#: Episodes for each instruction, after which one that none has is missed.
DRAWS = 20
#: A tool that moves less than this [m] from one such time [s] to the next stands still,
#: on average: commands have noise.
STILL, STILL_TIME = 0.005, 0.5


@dataclass(frozen=True)
class Demonstration:
    """One recorded episode of L control steps; row t precedes action t.

    Attributes:
        state: Report of the robot's sensors, shape (L, S).
        environment_state: Report of the camera, shape (L, E), [m].
        action: Command, shape (L, A), in [-1, 1].
        instruction: The instruction's text.
        success: Whether the task was solved at the end.
        episode: Its number: it starts as
            ``task.initial_state(default_rng([seed, episode]))``.
    """

    state: Array
    environment_state: Array
    action: Array
    instruction: str
    success: bool
    episode: int


@dataclass(frozen=True)
class Episode:
    """One episode of an expert, solved or not.

    Attributes:
        number: It starts as ``task.initial_state(default_rng([seed, number]))``.
        demonstration: What was recorded.
        stopped: Whether the tool stood still at the end.
    """

    number: int
    demonstration: Demonstration
    stopped: bool


class ExpertError(RlcoError):
    """An expert that fails in its own task.

    Attributes:
        reason: Where it fails, without a full stop.
        seed: Of its episodes.
        episode: The first that failed, to be looked at.
    """

    def __init__(self, reason: str, seed: int, episode: Episode) -> None:
        self.reason, self.seed, self.episode = reason, seed, episode
        super().__init__(f"{reason}; correct the expert or the domain.")


def demonstrate(
    task: Task,
    domain: GivenDomain,
    *,
    episodes: int,
    seed: int,
    noise: float = 0.1,
    hold: int = 15,
    num_envs: int = 20,
    effects: Given = None,
) -> Iterator[Demonstration]:
    """Yield successful demonstrations of the expert, in the order of their seeds.

    Every instruction is demonstrated equally often, to within one, because training
    could not make up for one that is missing by chance.

    The expert uses the true state; what is recorded is the report of the domain's
    sensors and camera. Commands carry Gaussian noise, as a teleoperator's do. Failed
    episodes are dropped, as people drop theirs.

    Args:
        task: The task.
        domain: Domain of the recording: a domain, its name or file.
        episodes: Successful episodes to yield.
        seed: Determines initial states, sensor noise and command noise.
        noise: Standard deviation of command noise, relative to the action's range.
        hold: Control steps kept after the task is solved [steps].
        num_envs: Maximum number of episodes in parallel.
        effects: Effects to add to the model, see `rlco.envs.make_env`.

    Raises:
        ExpertError: If the expert fails in more than half of many episodes, or of those
            with one of the instructions.
        RlcoError: If no episode has one of the instructions.
        ConfigError: If the parts of a task of yours do not fit each other.
    """
    task, domain = check_task(task), make_domain(domain)
    count = min(num_envs, episodes)
    stepper = NativeStepper(task, domain, num_envs=count, effects=effects)
    share, more = divmod(episodes, len(task.instructions))
    wanted = {
        text: share + (index < more) for index, text in enumerate(task.instructions)
    }
    tried: list[Episode] = []
    while any(wanted.values()):
        _check_expert(task, domain, seed, tried)
        _check_drawn(task, tried)
        for episode in _batch(task, domain, stepper, seed, len(tried), noise, hold):
            tried.append(episode)
            text = episode.demonstration.instruction
            if episode.demonstration.success and wanted[text]:
                wanted[text] -= 1
                yield episode.demonstration
    if failed := [episode for episode in tried if not episode.demonstration.success]:
        reason = _failures(task, domain, seed, tried, failed)
        _logger.info("%s; failed episodes are not recorded", reason)


def _check_expert(task: Task, domain: Domain, seed: int, tried: list[Episode]) -> None:
    """Refuse to go on with an expert that hardly ever succeeds.

    Raises:
        ExpertError: See `demonstrate`.
    """
    groups = [tried]
    if len(task.instructions) > 1:  # one that always fails would be waited for
        groups += [
            [one for one in tried if one.demonstration.instruction == text]
            for text in task.instructions
        ]
    for group in groups:
        failed = [one for one in group if not one.demonstration.success]
        if len(group) >= MANY and len(failed) > len(group) / 2:
            reason = _failures(task, domain, seed, group, failed)
            raise ExpertError(reason, seed, failed[0])


def _check_drawn(task: Task, tried: list[Episode]) -> None:
    """Refuse to wait for an instruction that no start has.

    Raises:
        RlcoError: One was never drawn in so many episodes that it cannot be chance.
    """
    if len(tried) < max(MANY, DRAWS * len(task.instructions)):
        return
    drawn = {one.demonstration.instruction for one in tried}
    for index, text in enumerate(task.instructions):
        if text not in drawn:
            raise RlcoError(
                f"none of {len(tried)} episodes of task {task.name!r} has instruction "
                f"{index}, {text!r}; let sample draw instruction_id among all "
                "instructions, or leave the sentence out."
            )


def _failures(
    task: Task,
    domain: Domain,
    seed: int,
    tried: list[Episode],
    failed: list[Episode],
) -> str:
    """Say in which episodes an expert failed, and in what way."""
    texts = {one.demonstration.instruction for one in tried}
    where = f"in domain {domain.name!r}"
    if len(texts) == 1 < len(task.instructions):
        where += f" where it was to {next(iter(texts))!r}"
    word = "episode" if len(failed) == 1 else "episodes"
    reason = (
        f"the expert of {task.name!r} solved only {len(tried) - len(failed)} of "
        f"{len(tried)} episodes {where}; it failed in {word} "
        f"{format_indices(one.number for one in failed)} of seed {seed}"
    )
    if stopped := sum(one.stopped for one in failed):
        reason += (
            f", and in {stopped} of them the tool stood still at the end: aim beyond "
            "where it must arrive, as an arm stops short of the goal that it is sent to"
        )
    return reason


def _batch(
    task: Task,
    domain: Domain,
    stepper: NativeStepper,
    seed: int,
    first: int,
    noise: float,
    hold: int,
) -> list[Episode]:
    """Run one episode in each world."""
    count = stepper.num_envs
    rngs = [np.random.default_rng([seed, first + i]) for i in range(count)]
    state = stepper.reset([task.initial_state(rng) for rng in rngs])
    shape = (task.horizon, len(task.action_names))
    jitter = noise * np.stack([rng.standard_normal(shape) for rng in rngs])
    # Hands shake less in rotation; the gripper is binary.
    jitter[..., POSITION.stop :] = 0.0
    size = (task.horizon, noise_size(task))
    sensor = np.stack([rng.standard_normal(size) for rng in rngs])
    robot, environment, action, solved, tool = [], [], [], [], []
    for t in range(task.horizon):
        observed = observe(task, domain, stepper.reported_state(), sensor[:, t])
        command = np.clip(task.expert(state) + jitter[:, t], -1.0, 1.0)
        after = stepper.step(command[:, None])
        state = after.at(np.s_[:, 1])
        robot.append(observed[0])
        environment.append(observed[1])
        action.append(command)
        solved.append(task.success(state))
        tool.append(state.tool_position)
    success = np.stack(solved)
    stopped = _stood_still(np.stack(tool), task.control_frequency)
    texts = [task.instructions[i] for i in state.instruction_id.tolist()]
    out = []
    for i in range(count):
        # Solved from here to the end: where a person would stop recording.
        unsolved = np.flatnonzero(~success[:, i])
        last_unsolved = int(unsolved[-1]) if unsolved.size else -1
        length = min(task.horizon, last_unsolved + 2 + hold)
        demonstration = Demonstration(
            state=np.stack(robot)[:length, i],
            environment_state=np.stack(environment)[:length, i],
            action=np.stack(action)[:length, i],
            instruction=texts[i],
            success=bool(success[-1, i]),
            episode=first + i,
        )
        out.append(Episode(first + i, demonstration, bool(stopped[i])))
    return out


def _stood_still(tool: Array, frequency: int) -> NDArray[np.bool_]:
    """Return whether tools (T, N, 3) hardly moved at the end, shape (N,)."""
    steps = round(STILL_TIME * frequency)
    if len(tool) < 2 * steps:
        return np.zeros(tool.shape[1], np.bool_)
    before, last = tool[-2 * steps : -steps].mean(0), tool[-steps:].mean(0)
    still: NDArray[np.bool_] = np.linalg.norm(last - before, axis=-1) < STILL
    return still
