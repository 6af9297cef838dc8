"""AdamW on weights of 16 bits: as on weights of 32, rounded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.optim.optimizers import load_optimizer_state, save_optimizer_state
from torch.optim import AdamW

from rlco.training import MasterWeightAdamW

NARROW = [torch.bfloat16, torch.float16]
OPTIONS: dict[str, Any] = {"lr": 4e-6, "weight_decay": 0.01, "betas": (0.8, 0.9)}


def weights(dtype: torch.dtype) -> list[torch.nn.Parameter]:
    """Return weights that any precision holds alike."""
    torch.manual_seed(0)
    start = [torch.randn(4, 3), torch.randn(5)]
    return [torch.nn.Parameter(w.mul(0.02).bfloat16().to(dtype)) for w in start]


def gradients(count: int) -> list[list[torch.Tensor]]:
    torch.manual_seed(1)
    return [[torch.randn(4, 3), torch.randn(5)] for _ in range(count)]


def follow(optimizer: torch.optim.Optimizer, steps: list[list[torch.Tensor]]) -> None:
    """Take these gradients' steps; bfloat16 holds each of them."""
    parameters = optimizer.param_groups[0]["params"]
    for step in steps:
        for parameter, gradient in zip(parameters, step, strict=True):
            parameter.grad = gradient.bfloat16().to(parameter.dtype)
        optimizer.step()


@pytest.mark.parametrize("dtype", NARROW)
def test_it_goes_where_float32_goes_and_is_rounded_once(dtype: torch.dtype) -> None:
    narrow, wide = weights(dtype), weights(torch.float32)
    steps = gradients(100)
    follow(MasterWeightAdamW(narrow, **OPTIONS), steps)
    follow(AdamW(wide, **OPTIONS), steps)
    for ours, theirs in zip(narrow, wide, strict=True):
        assert ours.dtype == dtype
        assert torch.equal(ours, theirs.to(dtype))


def test_steps_too_small_for_a_weight_add_up() -> None:
    start = torch.full((1,), 0.02, dtype=torch.bfloat16)
    ours, plain = (torch.nn.Parameter(start.clone()) for _ in range(2))
    options: dict[str, Any] = {"lr": 4e-6, "weight_decay": 0.0}
    for optimizer in (MasterWeightAdamW([ours], **options), AdamW([plain], **options)):
        follow(optimizer, [[torch.ones(1)]] * 100)
    assert torch.equal(plain, start)
    # A hundred steps of 4e-6; neighbours are 1.2e-4 apart.
    assert float(ours) == pytest.approx(float(start) - 4e-4, abs=0.7e-4)


def test_weights_of_32_bits_are_trained_as_by_adamw() -> None:
    ours, theirs = weights(torch.float32), weights(torch.float32)
    optimizers = MasterWeightAdamW(ours, **OPTIONS), AdamW(theirs, **OPTIONS)
    for optimizer in optimizers:
        follow(optimizer, gradients(10))
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
    for a, b in zip(*(o.state.values() for o in optimizers), strict=True):
        assert a.keys() == b.keys()


def test_weights_and_gradients_stay_the_tensors_that_they_were() -> None:
    parameters = weights(torch.bfloat16)
    places = [p.data_ptr() for p in parameters]
    optimizer = MasterWeightAdamW(parameters, lr=0.1)
    follow(optimizer, gradients(1))
    before = [p.grad for p in parameters]
    optimizer.step()
    for parameter, place, gradient in zip(parameters, places, before, strict=True):
        assert parameter.data_ptr() == place
        assert parameter.grad is gradient
        assert gradient is not None
        assert gradient.dtype == torch.bfloat16


def test_what_has_no_gradient_rests() -> None:
    parameters = weights(torch.bfloat16)
    optimizer = MasterWeightAdamW(parameters, lr=0.1)
    follow(optimizer, gradients(1))
    with torch.no_grad():
        parameters[1].fill_(3.0)
    parameters[1].grad = None
    before = parameters[0].detach().clone()
    optimizer.step()
    assert torch.equal(parameters[1], torch.full((5,), 3.0).bfloat16())
    assert not torch.equal(parameters[0], before)


def test_a_step_that_fails_changes_no_weight_and_is_made_good_by_the_next() -> None:
    parameters, others = weights(torch.bfloat16), weights(torch.bfloat16)
    broken, sound = (MasterWeightAdamW(p, lr=0.1) for p in (parameters, others))
    steps = gradients(2)
    for optimizer in (broken, sound):
        follow(optimizer, steps[:1])
    before = [p.detach().clone() for p in parameters]
    parameters[0].grad = torch.ones_like(parameters[0])
    parameters[1].grad = parameters[1].detach().to_sparse()
    with pytest.raises(RuntimeError, match="sparse"):
        broken.step()
    assert all(torch.equal(a, b) for a, b in zip(parameters, before, strict=True))
    for optimizer in (broken, sound):
        follow(optimizer, steps[1:])
    assert all(torch.equal(a, b) for a, b in zip(parameters, others, strict=True))


def test_hooks_see_each_step_once_with_the_weights_as_they_are() -> None:
    torch.optim.Adam([torch.zeros(1)])  # torch then wraps the step that it shares
    parameters = weights(torch.bfloat16)
    optimizer = MasterWeightAdamW(parameters, lr=0.1)
    seen: list[torch.Tensor] = []
    optimizer.register_step_post_hook(
        lambda *_: seen.append(parameters[0].detach().clone())
    )
    follow(optimizer, gradients(1))
    assert len(seen) == 1
    assert torch.equal(seen[0], parameters[0])


@pytest.mark.parametrize("options", [{"fused": True}, {"amsgrad": True}])
def test_adamws_own_options_work(options: dict[str, Any]) -> None:
    narrow, wide = weights(torch.bfloat16), weights(torch.float32)
    follow(MasterWeightAdamW(narrow, **OPTIONS, **options), gradients(50))
    follow(AdamW(wide, **OPTIONS, **options), gradients(50))
    for ours, theirs in zip(narrow, wide, strict=True):
        assert torch.equal(ours, theirs.bfloat16())


def test_a_closure_is_called_once_and_its_loss_returned() -> None:
    (weight,) = parameters = [torch.nn.Parameter(torch.ones(1, dtype=torch.bfloat16))]
    optimizer = MasterWeightAdamW(parameters, lr=0.1, weight_decay=0.0)
    calls = []

    def closure() -> float:
        calls.append(1)
        optimizer.zero_grad()
        loss = 3 * weight.sum()
        loss.backward()
        return float(loss)

    assert optimizer.step(closure) == 3.0
    assert len(calls) == 1
    assert float(weight) == pytest.approx(0.9, abs=0.004)


def test_an_interrupted_training_goes_on_alike(tmp_path: Path) -> None:
    """By the way LeRobot writes an optimiser's state."""
    whole, part = weights(torch.bfloat16), weights(torch.bfloat16)
    steps = gradients(40)
    follow(MasterWeightAdamW(whole, **OPTIONS), steps)
    first = MasterWeightAdamW(part, **OPTIONS)
    follow(first, steps[:20])
    save_optimizer_state(first, tmp_path)
    second = MasterWeightAdamW(part, **OPTIONS)
    load_optimizer_state(second, tmp_path)
    for held in second.state.values():
        assert {held[k].dtype for k in ("master", "exp_avg", "exp_avg_sq")} == {
            torch.float32
        }
    follow(second, steps[20:])
    assert all(torch.equal(a, b) for a, b in zip(whole, part, strict=True))


@pytest.mark.parametrize(
    ("first", "second"), [(AdamW, MasterWeightAdamW), (MasterWeightAdamW, AdamW)]
)
def test_it_goes_on_from_a_state_of_adamw_and_adamw_from_its(
    first: type[AdamW], second: type[AdamW]
) -> None:
    parameters = weights(torch.bfloat16)
    before, after = first(parameters, lr=0.1), second(parameters, lr=0.1)
    follow(before, gradients(3))
    after.load_state_dict(before.state_dict())
    follow(after, gradients(1))
    for held in after.state.values():
        assert float(held["step"]) == 4
        if second is MasterWeightAdamW:
            assert held["exp_avg"].dtype == held["master"].dtype == torch.float32


def test_weights_changed_elsewhere_are_followed() -> None:
    (weight,) = parameters = [torch.nn.Parameter(torch.ones(2, dtype=torch.bfloat16))]
    optimizer = MasterWeightAdamW(parameters, lr=1e-3, weight_decay=0.0)
    ones = [[torch.ones(2)]]
    follow(optimizer, ones)
    with torch.no_grad():
        weight[0] = 5.0
    follow(optimizer, ones)
    master = optimizer.state[weight]["master"]
    # One step of 1e-3 from the new one, two from the one that stayed.
    torch.testing.assert_close(master, torch.tensor([4.999, 0.998]))
