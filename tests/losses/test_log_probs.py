"""The ratio of the first minibatches after a rollout is 1, in every precision."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.losses import CoTrainingLoss, log_probs
from rlco.policies import GaussianPolicy, ValueNetwork, make_policy

KINDS: list[tuple[str, dict[str, Any]]] = [
    ("gaussian", {}),
    *(("token", {"log_prob_level": level}) for level in ("chunk", "action", "token")),
    *(
        ("token", {"temperature": 1.6, "log_prob_level": level})
        for level in ("chunk", "token")
    ),
    *(
        (
            "flow",
            {"method": method, "noisy_steps": steps, "denoise_reduction": reduction},
        )
        for method in ("flow_noise", "flow_sde")
        for steps, reduction in (("all", "mean"), ("all", "sum"), ("one", "mean"))
    ),
    *(
        ("flow", {"log_prob_level": level, "denoise_reduction": reduction})
        for level in ("action", "token")
        for reduction in ("mean", "sum")
    ),
    ("flow", {"method": "fpo"}),
]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "bfloat16", "autocast"])
@pytest.mark.parametrize(("kind", "options"), KINDS)
def test_first_ratio_is_one(precision: str, kind: str, options: dict[str, Any]) -> None:
    torch.manual_seed(0)
    policy = make_policy(kind, state_size=12, chunk=4, hidden=(64, 64), **options)
    for module in policy.modules():
        if hasattr(module, "gain"):  # heads start near zero and would hide rounding
            torch.nn.init.normal_(module.weight, 0.0, 0.1)
    if kind == "token":
        torch.nn.init.normal_(policy.network.head, 0.0, 0.3)
    value = ValueNetwork(12, hidden=(8,))
    content = {"observation": {"state": torch.randn(8, 40, 12)}}
    td = TensorDict(content, [8, 40])
    with torch.no_grad():
        td = policy(td)
    rollout_log_probs = td["vla_action", "log_probs"].clone()
    if precision == "bfloat16":
        policy, value = policy.bfloat16(), value.bfloat16()
    autocast = torch.autocast("cpu", torch.bfloat16, enabled=precision == "autocast")
    td["advantage"] = torch.randn(8, 40, 1)
    td["value_target"] = torch.randn(8, 40, 1)

    with autocast:
        td["vla_action", "log_probs"] = log_probs(policy, td, rows=64)
    assert td["vla_action", "log_probs"].dtype == torch.float32
    if precision != "float32":  # or there would have been nothing to recompute
        difference = td["vla_action", "log_probs"] - rollout_log_probs
        assert difference.abs().max() > 1e-4

    functional = precision != "autocast"
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, value, functional=functional, entropy_bonus=False),
        None,
        real_coeff=0,
    )
    flat = td.reshape(-1)
    for rows in torch.randperm(320).split(64):
        with autocast:
            out = loss(TensorDict({"sim": flat[rows]}))
        assert float(out["max_ratio"]) == pytest.approx(1, abs=1e-5)
        assert float(out["mean_ratio"]) == pytest.approx(1, abs=1e-5)
        assert float(out["kl_approx"]) == pytest.approx(0, abs=1e-5)


def test_by_hand_on_two_batch_dimensions() -> None:
    # Mean 0, std 0.2, one number x = 0.2: log N = -x^2/(2 std^2) - log(std sqrt(2 pi))
    # = -0.5 + 1.609438 - 0.918939 = 0.190499; a chunk of 2 doubles it.
    policy = GaussianPolicy(1, chunk=2, action_size=1, hidden=(4,))
    policy.network.head.weight.data.zero_()
    td = TensorDict({"observation": {"state": torch.ones(2, 3, 1)}}, [2, 3])
    td["vla_action", "sample"] = torch.full((2, 3, 2, 1), 0.2)
    found = log_probs(policy, td)
    torch.testing.assert_close(found, torch.full((2, 3), 0.380998))
    assert not found.requires_grad
