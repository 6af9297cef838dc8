"""Quantile normalisation: bounded where data hardly moved, and invertible."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from rlco.errors import ConfigError, DataError
from rlco.policies import GaussianPolicy
from rlco.policies.nets.encoder import OBSERVATION_CLIP, ObservationEncoder
from rlco.policies.nets.normalizer import QuantileNormalizer


def make(low: list[float], high: list[float], **options: float) -> QuantileNormalizer:
    norm = QuantileNormalizer(len(low), name="x", **{"min_range": 0.2, **options})
    norm.set_quantiles(low, high)
    return norm


def test_quantiles_map_to_minus_one_and_one() -> None:
    norm = make([0.0, -3.0], [4.0, -1.0])
    corners = norm(torch.tensor([[0.0, -3.0], [4.0, -1.0], [2.0, -2.0]]))
    expected = torch.tensor([[-1.0, -1.0], [1.0, 1.0], [0.0, 0.0]])
    torch.testing.assert_close(corners, expected)


def test_a_constant_feature_maps_to_zero_and_is_not_blown_up() -> None:
    # The range becomes .2 about .5: a noise of .001 is 2 * .001 / .2 = .01.
    norm = make([0.5], [0.5])
    torch.testing.assert_close(
        norm(torch.tensor([[0.5], [0.501]])), torch.tensor([[0.0], [0.01]])
    )


@settings(max_examples=50, deadline=None)
@given(
    low=st.floats(-1, 1, width=32),
    width=st.floats(0, 2, width=32),
    raw=st.floats(-1, 1, width=32),
)
def test_inverse_undoes_it(low: float, width: float, raw: float) -> None:
    norm = make([low], [low + width])
    value = torch.tensor([raw])
    torch.testing.assert_close(norm.inverse(norm(value)), value, atol=1e-5, rtol=0)


def test_observations_are_clipped_far_outside_the_data() -> None:
    encoder = ObservationEncoder(1)
    encoder.set_normalization(state=([0.0], [1.0]))
    td = TensorDict({"observation": {"state": torch.tensor([[100.0], [-100.0]])}}, [2])
    expected = torch.tensor([[OBSERVATION_CLIP], [-OBSERVATION_CLIP]])
    assert torch.equal(encoder(td), expected)


def test_a_number_that_never_moved_in_the_demonstrations_reaches_the_limits() -> None:
    # A gripper that stayed closed at -1 has range .2: +1 is normalised 20, the
    # opposite side, which the unbounded mean can give; its exploration is .02 raw.
    policy = GaussianPolicy(1, chunk=1, action_size=2, hidden=(4,))
    policy.set_normalization(action=([-1.0, -1.0], [1.0, -1.0]))
    norm = policy.action_normalizer
    torch.testing.assert_close(
        norm(torch.tensor([1.0, 1.0])), torch.tensor([1.0, 20.0])
    )
    spread = norm.inverse(torch.tensor([0.2, 0.2])) - norm.inverse(torch.zeros(2))
    torch.testing.assert_close(spread, torch.tensor([0.2, 0.02]))


def test_numpy_quantiles_are_taken() -> None:
    norm = QuantileNormalizer(2, name="x", min_range=0.1)
    norm.set_quantiles(np.array([0.0, 1.0]), np.array([2.0, 3.0], dtype=np.float32))
    torch.testing.assert_close(norm.high, torch.tensor([2.0, 3.0]))


@pytest.mark.parametrize("value", [1e7, -1e17])
def test_a_large_constant_has_a_range_in_float32(value: float) -> None:
    norm = make([value], [value])
    assert norm(torch.tensor([value])).abs() < 0.5
    assert torch.isfinite(norm(torch.tensor([0.0]))).all()


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        ([0.0], [1.0], r"shape \(1,\)"),
        ([0.0, float("nan")], [1.0, 1.0], "NaN"),
        ([0.0, 2.0], [1.0, 1.0], "out of order at index 1: 2 > 1"),
    ],
)
def test_wrong_quantiles_are_refused_and_change_nothing(
    low: list[float], high: list[float], message: str
) -> None:
    norm = QuantileNormalizer(2, name="state", min_range=0.1)
    with pytest.raises(DataError, match=message):
        norm.set_quantiles(low, high)
    assert torch.equal(norm.low, -torch.ones(2))


def test_quantiles_of_what_is_not_read_are_refused() -> None:
    policy = GaussianPolicy(1, chunk=1)
    with pytest.raises(DataError, match="environment_state_size=0"):
        policy.set_normalization(environment_state=([0.0], [1.0]))
    with pytest.raises(ConfigError, match="must be positive"):
        QuantileNormalizer(1, name="x", min_range=0.0)
