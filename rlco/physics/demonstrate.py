"""Demonstrations by a task's scripted expert."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rlco.errors import RlcoError
from rlco.physics.domain import Domain
from rlco.physics.mended_model import Given
from rlco.physics.native import NativeStepper
from rlco.physics.observation import noise_size, observe
from rlco.physics.task import Array, Task


@dataclass(frozen=True)
class Demonstration:
    """One recorded episode of L control steps; row t holds what led to action t.

    Attributes:
        state: What the robot's sensors reported, shape (L, 7).
        environment_state: What the camera reported, shape (L, E), [m].
        action: What was commanded, shape (L, 7), in [-1, 1].
        instruction: The instruction's text.
        success: Whether the task was solved at the end.
    """

    state: Array
    environment_state: Array
    action: Array
    instruction: str
    success: bool


def demonstrate(
    task: Task,
    domain: Domain,
    *,
    episodes: int,
    seed: int,
    noise: float = 0.1,
    hold: int = 15,
    num_envs: int = 20,
    effects: Given = None,
) -> Iterator[Demonstration]:
    """Yield successful demonstrations of the expert, in the order of their seeds.

    Every instruction is demonstrated equally often, to within one, as people do: what
    one would otherwise miss by chance no training could make good.

    The expert sees the true state; what is recorded is what the domain's sensors
    and camera report. Commands carry Gaussian noise, as a teleoperator's do.
    Failed episodes are dropped, as people drop theirs.

    Args:
        task: The task.
        domain: Where it is recorded.
        episodes: Successful episodes to yield.
        seed: Draws initial states, sensor noise and command noise.
        noise: Standard deviation of command noise, in units of the action's range.
        hold: Control steps kept after the task is solved [steps].
        num_envs: Episodes that run side by side, at most.
        effects: Effects to add to the model, see `rlco.envs.make_env`.

    Raises:
        RlcoError: If the expert fails in more than half of many episodes.
    """
    count = min(num_envs, episodes)
    stepper = NativeStepper(task, domain, num_envs=count, effects=effects)
    share, more = divmod(episodes, len(task.instructions))
    wanted = {
        text: share + (index < more) for index, text in enumerate(task.instructions)
    }
    solved = tried = 0
    while any(wanted.values()):
        if tried >= 40 and solved < tried / 2:
            raise RlcoError(
                f"the expert of {task.name!r} solved only {solved} of {tried} "
                f"episodes in domain {domain.name!r}; mend the expert or the domain."
            )
        for demonstration in _batch(task, domain, stepper, seed, tried, noise, hold):
            tried += 1
            solved += demonstration.success
            if demonstration.success and wanted[demonstration.instruction]:
                wanted[demonstration.instruction] -= 1
                yield demonstration


def _batch(
    task: Task,
    domain: Domain,
    stepper: NativeStepper,
    seed: int,
    first: int,
    noise: float,
    hold: int,
) -> list[Demonstration]:
    """Run one episode in each copy."""
    count = stepper.num_envs
    rngs = [np.random.default_rng([seed, first + i]) for i in range(count)]
    state = stepper.reset([task.sample(rng, None) for rng in rngs])
    jitter = noise * np.stack([rng.standard_normal((task.horizon, 7)) for rng in rngs])
    jitter[..., 3:] = 0.0  # hands shake less in rotation; the gripper is a switch
    size = (task.horizon, noise_size(task))
    sensor = np.stack([rng.standard_normal(size) for rng in rngs])
    robot, environment, action, solved = [], [], [], []
    for t in range(task.horizon):
        seen = observe(task, domain, stepper.reported_state(), sensor[:, t])
        command = np.clip(task.expert(state) + jitter[:, t], -1.0, 1.0)
        after = stepper.step(command[:, None])
        state = after.at(np.s_[:, 1])
        robot.append(seen[0])
        environment.append(seen[1])
        action.append(command)
        solved.append(task.success(state))
    success = np.stack(solved)
    texts = [task.instructions[i] for i in state.instruction_id.tolist()]
    out = []
    for i in range(count):
        # From here on it stays solved; the end of what a person would record.
        unsolved = np.flatnonzero(~success[:, i])
        last_unsolved = int(unsolved[-1]) if unsolved.size else -1
        length = min(task.horizon, last_unsolved + 2 + hold)
        out.append(
            Demonstration(
                state=np.stack(robot)[:length, i],
                environment_state=np.stack(environment)[:length, i],
                action=np.stack(action)[:length, i],
                instruction=texts[i],
                success=bool(success[-1, i]),
            )
        )
    return out
