"""Demonstrations of the planar task's expert, as replay buffers."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage

from planar.env import CHUNK, PlanarTask
from planar.gaps import NUMBERS, Gap
from planar.world import World, draw_start
from rlco import keys
from rlco.data import DemoReplayBuffer
from rlco.data.demos import DemoMeta, chunk_indices
from rlco.errors import RlcoError

Array = NDArray[np.float64]

NOISE = 0.06  # on the expert's commands, in units of their range
REST = 15  # control steps of a demonstration after it is solved for good


class Played(NamedTuple):
    """What an expert did, T control steps of M episodes.

    Attributes:
        state: Before each step, shape (T, M, 2) [m].
        environment_state: Before each step, shape (T, M, 12) [m].
        action: Shape (T, M, 2).
        solved: After each step, shape (T, M).
        target: Which disc counted, shape (M,).
    """

    state: Array
    environment_state: Array
    action: Array
    solved: NDArray[np.bool_]
    target: NDArray[np.int64]


def play_expert(gap: Gap, episodes: int, seed: int, noise: float = NOISE) -> Played:
    """Play the first M episodes of a seed with a noisy expert."""
    world, steps = World(episodes, gap), PlanarTask.horizon
    rngs = [np.random.default_rng([seed, index]) for index in range(episodes)]
    world.reset(range(episodes), [draw_start(rng) for rng in rngs])
    jitter = np.stack([rng.standard_normal((steps, 2)) for rng in rngs], 1)
    sensor = np.stack([rng.standard_normal((steps, NUMBERS // 2, 2)) for rng in rngs])
    rows: list[tuple[Array, Array, Array, NDArray[np.bool_]]] = []
    active = np.ones(episodes, dtype=np.bool_)
    for step in range(steps):
        observed = world.observed(sensor[:, step])
        action = np.clip(world.expert() + noise * jitter[step], -1.0, 1.0)
        world.step(action, active)
        rows.append((*observed, action, world.solved()))
    state, environment_state, action, solved = map(np.stack, zip(*rows, strict=True))
    return Played(state, environment_state, action, solved, world.target)


def record(gap: Gap, episodes: int, seed: int) -> DemoReplayBuffer:
    """Return solved demonstrations, as many of each instruction as of the others.

    Rows are as `rlco.data.load_demos` loads them.

    Args:
        gap: Where to record.
        episodes: How many.
        seed: Draws starts and noise.

    Raises:
        RlcoError: The expert solves too few.
    """
    played = play_expert(gap, max(30, 3 * episodes), seed)
    kept = _chosen(played, episodes)
    # Until it has stayed solved for REST steps, or to the end.
    unsolved = [np.flatnonzero(~played.solved[:, index]) for index in kept]
    lengths = [min(u[-1] + 2 + REST, PlanarTask.horizon) for u in unsolved]
    parts = [
        _episode(played, index, int(length), number)
        for number, (index, length) in enumerate(zip(kept, lengths, strict=True))
    ]
    rows = torch.cat(parts)
    indices, is_pad = chunk_indices([int(length) for length in lengths], CHUNK)
    rows.set(keys.CHUNK, rows[keys.ACTION][indices])
    rows.set(keys.IS_PAD, is_pad)
    buffer = DemoReplayBuffer(_meta(lengths), LazyTensorStorage(len(rows)))
    buffer.extend(rows)
    return buffer


def _chosen(played: Played, episodes: int) -> list[int]:
    """Return the first solved episodes, instructions in equal numbers."""
    kinds = len(PlanarTask.instructions)
    wanted = [episodes // kinds + (kind < episodes % kinds) for kind in range(kinds)]
    solved = played.solved[-1]
    found = [
        index
        for kind, count in enumerate(wanted)
        for index in np.flatnonzero(solved & (played.target == kind))[:count].tolist()
    ]
    if len(found) < episodes:
        raise RlcoError(
            f"the expert solved {int(solved.sum())} of {solved.size} episodes, too few "
            f"for {episodes} demonstrations; ask for fewer."
        )
    return sorted(found)


def _episode(played: Played, index: int, length: int, number: int) -> TensorDict:
    def tensor(values: Array) -> torch.Tensor:
        return torch.from_numpy(values[:length, index]).float()

    rows = TensorDict(batch_size=[length])
    rows.set(keys.STATE, tensor(played.state))
    rows.set(keys.ENVIRONMENT_STATE, tensor(played.environment_state))
    rows.set(keys.ACTION, tensor(played.action))
    target = int(played.target[index])
    rows.set(keys.INSTRUCTION_ID, torch.full((length,), target, dtype=torch.int64))
    rows.set("episode", torch.full((length,), number, dtype=torch.int64))
    rows.set("frame", torch.arange(length))
    return rows


def _meta(lengths: list[int]) -> DemoMeta:
    return DemoMeta(
        path=Path(),
        fps=float(PlanarTask.control_frequency),
        robot_type="planar",
        state_names=PlanarTask.state_names,
        environment_state_names=PlanarTask.environment_state_names,
        action_names=PlanarTask.action_names,
        instructions=PlanarTask.instructions,
        episodes=tuple(range(len(lengths))),
        episode_lengths=tuple(int(length) for length in lengths),
        chunk=CHUNK,
        image_key=None,
        recorded={},
    )
