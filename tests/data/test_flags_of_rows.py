"""The buffer's flags: from which domain a row is, dropped as often as is asked."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from rlco.data import SimRealReplayBuffer
from rlco.errors import ConfigError
from rlco.keys import DOMAIN


def member(rows: int) -> TensorDictReplayBuffer:
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(rows))
    buffer.extend(TensorDict({"id": torch.arange(rows)}, [rows]))
    return buffer


def mixed(domain_flag: float | None, batch_size: int = 8) -> SimRealReplayBuffer:
    return SimRealReplayBuffer(
        member(50),
        member(20),
        sim_ratio=0.5,
        batch_size=batch_size,
        generator=torch.Generator().manual_seed(0),
        domain_flag=domain_flag,
    )


def flags(batch: TensorDict) -> dict[str, list[float]]:
    return {
        root: sorted(set(rows[DOMAIN].flatten().tolist()))
        for root, rows in batch.items()
    }


def test_a_real_row_is_plus_one_a_simulated_one_minus_one() -> None:
    batch = mixed(0.0).sample()
    assert flags(batch) == {"sim": [-1.0], "real": [1.0]}
    assert batch["sim", DOMAIN].shape == (4, 1)
    assert batch["sim", DOMAIN].dtype == torch.float32
    for one in mixed(0.0):
        assert flags(one) == {"sim": [-1.0], "real": [1.0]}
    assert flags(mixed(1.0).sample()) == {"sim": [0.0], "real": [0.0]}


@pytest.mark.parametrize("probability", [0.1, 0.5])
def test_flags_are_dropped_as_often_as_is_asked(probability: float) -> None:
    batch = mixed(probability, batch_size=40_000).sample()
    for root in ("sim", "real"):
        share = float((batch[root, DOMAIN] == 0).double().mean())
        # Four standard deviations of a share of 20,000 draws.
        error = 4 * (probability * (1 - probability) / 20_000) ** 0.5
        assert share == pytest.approx(probability, abs=error)


def test_without_the_option_nothing_is_drawn_and_nothing_added() -> None:
    plain, flagged = mixed(None), mixed(0.1)
    first, other = plain.sample(), flagged.sample()
    assert DOMAIN not in first["sim"]
    assert first["sim", "id"].tolist() == other["sim", "id"].tolist()
    # The flags' own numbers, four for each root, are all that sets the two apart.
    generator = torch.Generator()
    generator.set_state(plain.state_dict()["generator"])
    for _ in range(2):
        torch.rand(4, 1, generator=generator)
    expected = flagged.state_dict()["generator"]
    assert torch.equal(generator.get_state(), expected)
    assert DOMAIN not in plain.sim[:]
    assert DOMAIN not in flagged.sim[:]


def test_flags_go_on_where_a_saved_buffer_stopped() -> None:
    buffer, again = mixed(0.5), mixed(0.5)
    buffer.sample()
    again.load_state_dict(buffer.state_dict())
    for _ in range(3):
        one, other = buffer.sample(), again.sample()
        for key in (
            (root, name) for root in ("sim", "real") for name in ("id", DOMAIN)
        ):
            assert torch.equal(one[key], other[key])


@pytest.mark.parametrize("probability", [-0.1, 1.5, float("nan")])
def test_what_is_no_probability_is_refused(probability: float) -> None:
    with pytest.raises(ConfigError, match="but a probability lies in"):
        mixed(probability)
