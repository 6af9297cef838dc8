"""Low-rank adapters: where they go, what they compute, how they are put back."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from rlco.errors import ConfigError
from rlco.policies.vla.lora import add_lora, has_lora, merged_state


def network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 4), nn.Tanh(), nn.Linear(4, 2))


def test_adapters_add_a_product_of_low_rank() -> None:
    model = network()
    weight, bias = model[2].weight.detach().clone(), model[2].bias.detach().clone()
    add_lora(model, [model[2]], rank=1, alpha=3)
    names = {n for n, p in model.named_parameters() if p.requires_grad}
    assert names == {"2.lora_A.default.weight", "2.lora_B.default.weight"}
    with torch.no_grad():
        model[2].lora_B["default"].weight.fill_(0.5)
    a = model[2].lora_A["default"].weight
    hidden = torch.randn(5, 4)
    by_hand = hidden @ (weight + 3 * torch.full((2, 1), 0.5) @ a).T + bias
    torch.testing.assert_close(model[2](hidden), by_hand)
    merged = merged_state(model)
    assert merged.keys() == network().state_dict().keys()
    torch.testing.assert_close(merged["2.weight"], weight + 1.5 * a.expand(2, 4))
    # Saving changes nothing.
    torch.testing.assert_close(model[2](hidden), by_hand)


def test_adapters_of_coarse_weights_are_fine_and_told_what_merging_loses(
    caplog: pytest.LogCaptureFixture,
) -> None:
    model = network().bfloat16()
    add_lora(model, [model[2]], rank=1)
    adapters = [p for p in model.parameters() if p.requires_grad]
    assert {p.dtype for p in adapters} == {torch.float32}
    assert model(torch.ones(1, 3).bfloat16()).dtype == torch.bfloat16
    # Added to 1.5 and 0.75, 2 ** -10 is less than half of what lies between neighbours.
    with torch.no_grad():
        model[2].weight[0], model[2].weight[1] = 1.5, 0.75
        model[2].lora_A["default"].weight.fill_(2.0**-10)
        model[2].lora_B["default"].weight.fill_(1.0)
    merged = merged_state(model)
    assert torch.equal(merged["2.weight"], model[2].weight)
    assert "off by 100 % of its size" in caplog.text
    caplog.clear()
    with torch.no_grad():
        model[2].lora_A["default"].weight.fill_(0.25)
    merged = merged_state(model)
    assert merged["2.weight"].dtype == torch.bfloat16
    assert torch.equal(merged["2.weight"], model[2].weight + 0.25)
    assert not caplog.text


def test_a_model_without_adapters_says_so() -> None:
    model = network()
    assert not has_lora(model)
    add_lora(model, [model], rank=2)
    assert has_lora(model)


@pytest.mark.parametrize(("rank", "targets"), [(0, [0]), (1, [1])])
def test_nothing_to_adapt_is_refused(rank: int, targets: list[int]) -> None:
    model = network()
    with pytest.raises(ConfigError):
        add_lora(model, [model[i] for i in targets], rank=rank)
