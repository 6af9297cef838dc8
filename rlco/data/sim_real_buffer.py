"""The buffer that mixes simulated and real rows at an exact ratio."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import ReplayBuffer

from rlco.data.row_split import RowSplit
from rlco.errors import CheckpointError, ConfigError
from rlco.keys import DOMAIN, DOMAIN_FLAGS, REAL, SIM


class SimRealReplayBuffer:
    """Two TorchRL replay buffers that give one batch with roots ``sim`` and ``real``.

    ``sim_ratio`` is the share of SIM rows. What a batch cannot split evenly is
    carried to the next one, so the share is exact in the long run.
    The two roots keep their own keys, shapes and batch sizes.

    * Stage I, both are demonstrations: ``sample()`` draws from each by its sampler.
    * Stage II, ``sim`` is a rollout of flat decisions [B], refilled each iteration
      with ``empty()`` and ``extend(rollout)``: ``for batch in buffer`` makes exactly
      one pass over its rows in random order, each minibatch with freshly drawn real
      rows; 256 and 64 of them by ``sim_ratio=0.8, batch_size=320``. The last one holds
      the sim rows that are left and the real rows that keep the ratio, at least one.

    Both members draw from this object's generator. A member without a share may be
    None, and its root is left out.

    Args:
        sim: Simulated rows, or None with ``sim_ratio=0``.
        real: Real demonstrations, or None with ``sim_ratio=1``.
        sim_ratio: Share of sim rows, in [0, 1].
        batch_size: Rows of a batch, both roots together.
        generator: Source of randomness; None takes one seeded by torch's own.
        domain_flag: Probability with which a row's flag of its domain is dropped. Each
            batch then holds ``domain`` [n, 1], drawn anew: +1 for a real row, -1 for a
            simulated one, 0 where it is dropped. None: no flags.

    Raises:
        ConfigError: A ratio outside [0, 1], a missing member, a batch too small to
            hold a row of each, a member that cannot be mixed, or a probability outside
            [0, 1]; all reported together.

    Example:
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> def rows(n):
        ...     buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(n))
        ...     buffer.extend(TensorDict({"action": torch.zeros(n, 7)}, [n]))
        ...     return buffer
        >>> buffer = SimRealReplayBuffer(
        ...     rows(100), rows(20), sim_ratio=0.75, batch_size=10
        ... )
        >>> [len(buffer.sample()["sim"]) for _ in range(4)]
        [7, 8, 7, 8]
    """

    def __init__(
        self,
        sim: ReplayBuffer | None,
        real: ReplayBuffer | None,
        *,
        sim_ratio: float,
        batch_size: int,
        generator: torch.Generator | None = None,
        domain_flag: float | None = None,
    ) -> None:
        problems = _problems(sim, real, sim_ratio, batch_size)
        if domain_flag is not None and not 0.0 <= domain_flag <= 1.0:
            problems.append(
                f"domain_flag={domain_flag}, but a probability lies in [0, 1]"
            )
        if problems:
            raise ConfigError(problems)
        self.domain_flag = domain_flag
        self.sim = sim
        self.real = real
        self.batch_size = batch_size
        self._split = RowSplit(sim_ratio)
        if generator is None:
            seed = int(torch.randint(2**62, ()))
            generator = torch.Generator().manual_seed(seed)
        self._generator = generator
        self._share_generator()

    @property
    def sim_ratio(self) -> float:
        """Share of sim rows."""
        return float(self._split.ratio)

    def __len__(self) -> int:
        """Rows stored, both members together."""
        return sum(len(member) for member in self._members().values())

    def __repr__(self) -> str:
        sizes = ", ".join(f"{k}={len(m)} rows" for k, m in self._members().items())
        ratio, batch_size = self.sim_ratio, self.batch_size
        return f"SimRealReplayBuffer({sizes}, {ratio=}, {batch_size=})"

    def seed(self, seed: int) -> None:
        """Restart the random draws, and the carried remainder, from a seed."""
        self._generator.manual_seed(seed)
        self._split.carry = 0

    def reseed(self, seed: int) -> None:
        """Draw from a seed from now on; what a batch carried to the next one stays."""
        self._generator.manual_seed(seed)

    def sample(self, batch_size: int | None = None) -> TensorDict:
        """Draw a batch by the members' own samplers.

        Args:
            batch_size: Rows of both roots together; None takes the buffer's own.

        Returns:
            ``{"sim": [n_sim], "real": [n_real]}``, batch size [].

        Raises:
            ConfigError: The batch is too small, or a member empty.
        """
        total = self.batch_size if batch_size is None else batch_size
        if total < self._split.least_batch:
            raise ConfigError([_too_small(self._split, total)])
        n_sim = self._split.take(total)
        batch = TensorDict(batch_size=[])
        if n_sim:
            batch.set(SIM, _draw(SIM, self.sim, n_sim))
        if total > n_sim:
            batch.set(REAL, _draw(REAL, self.real, total - n_sim))
        self._set_flags(batch)
        return batch

    def __iter__(self) -> Iterator[TensorDict]:
        """Make one pass over sim, with fresh real rows in each minibatch.

        Raises:
            ConfigError: There are no sim rows to pass over.
        """
        if self.sim is None or not self._split.ratio or not len(self.sim):
            raise ConfigError(
                ["there are no sim rows to pass over; extend() sim, with sim_ratio > 0"]
            )
        rows = len(self.sim)
        order = torch.randperm(rows, generator=self._generator)
        start = 0
        while start < rows:
            n_sim = self._split.take(self.batch_size)
            n_real = self.batch_size - n_sim
            if start + n_sim > rows:
                self._split.give_back(self.batch_size, n_sim)
                n_sim = rows - start
                n_real = self._split.complete(n_sim)
            if len(self.sim) != rows:
                raise RuntimeError("sim was refilled during a pass over it")
            batch = TensorDict(batch_size=[])
            batch.set(SIM, self.sim[order[start : start + n_sim]])
            if n_real:
                batch.set(REAL, _draw(REAL, self.real, n_real))
            self._set_flags(batch)
            yield batch
            start += n_sim

    def extend(self, rollout: TensorDictBase) -> torch.Tensor:
        """Add rows to sim, and return where they were put."""
        # TorchRL writes an index into what it is given; the caller's stays as it is.
        index: torch.Tensor = self._require_sim().extend(rollout.copy())
        return index

    def empty(self) -> None:
        """Remove all rows of sim; the real ones stay."""
        self._require_sim().empty()

    def state_dict(self, *, rows: bool = True) -> dict[str, Any]:
        """Return what exact resuming needs; take it between passes, not within one.

        Args:
            rows: Whether to include the members' rows. Without them the state is
                small, and the members must be refilled as they were.
        """
        members = {
            name: member.state_dict() for name, member in self._members().items()
        }
        if not rows:
            members = {k: {"_sampler": m["_sampler"]} for k, m in members.items()}
        return self._mixing() | {
            "generator": self._generator.get_state().clone(),
            "members": members,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state.

        Raises:
            CheckpointError: It belongs to another ratio or other members.
        """
        self._check_state(state["sim_ratio"], set(state["members"]))
        for name, member in self._members().items():
            saved = state["members"][name]
            if "_storage" in saved:
                member.load_state_dict(saved)
            else:
                member.sampler.load_state_dict(saved["_sampler"])
        self._restore(int(state["carry"]), state["generator"])

    def dumps(self, path: str | Path) -> None:
        """Write members, remainder and generator to a folder."""
        path = Path(path)
        path.mkdir(parents=True, exist_ok=True)
        for name, member in self._members().items():
            member.dumps(path / name)
        np.save(path / "generator.npy", self._generator.get_state().numpy())
        mixing = self._mixing() | {"members": list(self._members())}
        (path / "mixing.json").write_text(json.dumps(mixing))

    def loads(self, path: str | Path) -> None:
        """Continue from a folder that ``dumps`` wrote.

        Raises:
            CheckpointError: It is not such a folder, or its ratio or members differ.
        """
        path = Path(path)
        if not (path / "mixing.json").is_file():
            raise CheckpointError(f"folder {str(path)!r} holds no sim-real buffer.")
        state = json.loads((path / "mixing.json").read_text())
        self._check_state(state["sim_ratio"], set(state["members"]))
        for name, member in self._members().items():
            member.loads(path / name)
        generator = torch.from_numpy(np.load(path / "generator.npy"))
        self._restore(int(state["carry"]), generator)

    def _set_flags(self, batch: TensorDict) -> None:
        """Write from which domain rows are, and drop that of some; None: do nothing."""
        if self.domain_flag is None:
            return
        for root, rows in batch.items():
            drawn = torch.rand(len(rows), 1, generator=self._generator)
            kept = (drawn >= self.domain_flag).to(drawn.dtype)
            rows.set(DOMAIN, DOMAIN_FLAGS[root] * kept)

    def _mixing(self) -> dict[str, Any]:
        return {"sim_ratio": str(self._split.ratio), "carry": self._split.carry}

    def _members(self) -> dict[str, ReplayBuffer]:
        members = {SIM: self.sim, REAL: self.real}
        return {name: m for name, m in members.items() if m is not None}

    def _require_sim(self) -> ReplayBuffer:
        if self.sim is None:
            raise ConfigError(["this buffer was built without sim, so it has no rows"])
        return self.sim

    def _share_generator(self) -> None:
        # TorchRL gives each member a generator of its own when it loads a state:
        # two with one state would draw the same numbers for sim and real.
        for member in self._members().values():
            member.set_rng(self._generator)

    def _check_state(self, ratio: str, members: set[str]) -> None:
        if Fraction(ratio) != self._split.ratio or members != set(self._members()):
            raise CheckpointError(
                f"the saved buffer mixes {sorted(members)} by sim_ratio={ratio}, this "
                f"one {sorted(self._members())} by {self._split.ratio}; build it as "
                "the saved one."
            )

    def _restore(self, carry: int, generator: torch.Tensor) -> None:
        self._split.carry = carry
        self._generator.set_state(generator)
        self._share_generator()


def batch_problems(sim_ratio: float, batch_size: int) -> list[str]:
    """Return what is wrong with a batch size for a share of sim rows within [0, 1].

    Example:
        >>> batch_problems(0.5, 2)
        []
        >>> batch_problems(0.9, 2)
        ['batch_size=2 is too small for sim_ratio=0.9: at least 10 rows are needed for \
one of each kind']
    """
    split = RowSplit(sim_ratio)
    return [_too_small(split, batch_size)] if batch_size < split.least_batch else []


def _problems(
    sim: ReplayBuffer | None,
    real: ReplayBuffer | None,
    sim_ratio: float,
    batch_size: int,
) -> list[str]:
    if not 0.0 <= sim_ratio <= 1.0:
        return [f"sim_ratio={sim_ratio}, but a share lies in [0, 1]"]
    problems = []
    if sim is None and sim_ratio > 0:
        problems.append(f"sim_ratio={sim_ratio} needs sim, which is None")
    if real is None and sim_ratio < 1:
        problems.append(f"sim_ratio={sim_ratio} needs real, which is None")
    problems += batch_problems(sim_ratio, batch_size)
    if sim is not None and sim.storage.ndim != 1:
        problems.append(
            f"sim stores rows of {sim.storage.ndim} dimensions; use a storage with "
            "ndim=1 and extend it with flat decisions [B]"
        )
    return problems


def _too_small(split: RowSplit, batch_size: int) -> str:
    return (
        f"batch_size={batch_size} is too small for sim_ratio={float(split.ratio):g}: "
        f"at least {split.least_batch} rows are needed for one of each kind"
    )


def _draw(root: str, buffer: ReplayBuffer | None, rows: int) -> TensorDictBase:
    """Draw exactly ``rows`` rows.

    A sampler without replacement gives fewer at the end of its pass and starts
    another one; a prefetching buffer gives the number asked for earlier.
    """
    if buffer is None or not len(buffer):
        raise ConfigError([f"the {root} buffer is empty, so nothing can be sampled"])
    parts = [buffer.sample(rows)]
    while (missing := rows - sum(len(part) for part in parts)) > 0:
        parts.append(buffer.sample(missing))
    if missing < 0:
        problem = f"the {root} buffer gave {-missing} rows more than asked for"
        raise ConfigError([f"{problem}; build it without prefetch"])
    return parts[0] if len(parts) == 1 else torch.cat(parts)
