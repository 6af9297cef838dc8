"""What counts as finite: every kind of number, and masks that mean their infinity."""

from __future__ import annotations

import pytest
import torch

from rlco.errors import CheckpointError, NonFiniteError
from rlco.finite import (
    check_loaded,
    check_saved,
    check_step,
    check_weights,
    is_finite,
    named_tensors,
)

FLOATS = [torch.float32, torch.float64, torch.float16, torch.bfloat16]


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_one_number_of_many_is_found(dtype: torch.dtype, value: float) -> None:
    tensor = torch.ones(64, 64, dtype=dtype)
    assert is_finite(tensor)
    tensor[40, 3] = value
    assert not is_finite(tensor)
    # They would cancel each other in a sum only to NaN.
    tensor[2, 3] = -value
    assert not is_finite(tensor)


@pytest.mark.parametrize("dtype", FLOATS)
def test_large_numbers_are_finite_though_their_sum_is_not(dtype: torch.dtype) -> None:
    tensor = torch.full((8,), torch.finfo(dtype).max, dtype=dtype)
    assert is_finite(tensor)
    model = torch.nn.Linear(2, 2).to(dtype)
    model.weight.data.fill_(torch.finfo(dtype).max)
    check_weights("update 1", {"policy": model})


def test_integers_flags_and_nothing_are_finite() -> None:
    for tensor in (torch.arange(3), torch.tensor([True]), torch.zeros(0)):
        assert is_finite(tensor)


def test_masks_may_be_infinite_where_weights_may_not() -> None:
    mask = torch.zeros(3, 3).masked_fill(torch.ones(3, 3).triu(1) > 0, -torch.inf)
    check_saved("the policy", [("mask", mask)])
    check_loaded("file", [("mask", mask)])
    for spoiled in (mask + 0.1, -mask, torch.full((2,), -torch.inf)):
        with pytest.raises(NonFiniteError, match="bias is infinite"):
            check_saved("the policy", [("mask", mask), ("bias", spoiled)])
        with pytest.raises(CheckpointError, match="bias is infinite"):
            check_loaded("file", [("mask", mask), ("bias", spoiled)])


def test_tensors_are_found_in_a_nested_state_and_named_by_their_place() -> None:
    state = {"optimizer": {"state": {0: {"exp_avg": torch.ones(2), "step": 3}}}}
    nested = {"parts": [state, (torch.zeros(1), None)], "name": "x"}
    assert [name for name, _ in named_tensors(nested)] == [
        "parts.0.optimizer.state.0.exp_avg",
        "parts.1.0",
    ]


@pytest.mark.parametrize("dtype", FLOATS)
def test_what_became_nan_first_is_named(dtype: torch.dtype) -> None:
    model = torch.nn.Linear(2, 1).to(dtype)
    terms = {"loss_bc": torch.ones((), dtype=dtype), "loss_x": torch.ones(())}
    norms = [torch.ones((), dtype=dtype)]
    model.weight.grad = torch.ones_like(model.weight)

    def told() -> str:
        with pytest.raises(NonFiniteError) as caught:
            check_step("update 17", terms.items(), norms, {"actor": model})
        return str(caught.value)

    check_step("update 17", terms.items(), norms, {"actor": model})
    norms[0] = norms[0] * torch.inf
    assert told().startswith("the norm of the gradient is infinite in update 17")
    model.weight.grad[0, 1] = torch.nan
    assert told().startswith("the gradient of actor.weight is nan (1 of 2 ")
    terms["loss_x"] = terms["loss_x"] * torch.nan
    assert told().startswith("loss_x became nan in update 17")
    model.bias.data.fill_(torch.inf)
    assert told().startswith("actor.bias is infinite (1 of 1 ")


@pytest.mark.parametrize(
    ("module", "advice"),
    [
        ("policy", "lower lr."),
        ("critic", "lower critic_lr."),
        ("noise", "lr and critic"),
    ],
)
def test_the_rate_is_named_that_the_weight_learns_at(module: str, advice: str) -> None:
    spoiled = torch.nn.Linear(1, 1)
    spoiled.weight.data.fill_(torch.nan)
    with_noise = torch.nn.ModuleDict({"noise": spoiled})
    parts = {"policy": with_noise} if module == "noise" else {module: spoiled}
    with pytest.raises(NonFiniteError, match=advice):
        check_weights("update 3", parts)
