"""How far a policy has moved on held-out demonstrations, without moving anything."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from rlco import keys
from rlco.errors import ConfigError
from rlco.policies import FlowPolicy, GaussianPolicy
from rlco.training.held_out import HeldOut
from rlco.training.imitation_errors import likely_chunks
from rlco.training.options.stage_two_options import StageTwoOptions
from rlco.training.stage_two import check_stage_two, warn_of_trained_on


class Frames:
    """Held-out demonstrations of two frames, the last step of the second padded."""

    def frames(self) -> TensorDict:
        return TensorDict(
            {
                "observation": {"state": torch.zeros(2, 3)},
                "vla_action": {"chunk": torch.zeros(2, 2, 1)},
                keys.IS_PAD: torch.tensor([[False, False], [False, True]]),
            },
            [2],
        )


def test_drift_is_how_far_actions_moved_in_units_of_their_range() -> None:
    policy = GaussianPolicy(3, chunk=2, action_size=1, hidden=(4,))
    low, high = torch.tensor([-0.5]), torch.tensor([0.5])
    policy.set_normalization(action=(low, high))
    drift = HeldOut(policy, Frames())
    assert drift.measure(policy)["drift_heldout"] == 0.0
    # The head's output is the normalised mean: steps move by .1, .3, .1 and a padded
    # .3, so the mean square of the real ones is .11 / 3.
    with torch.no_grad():
        policy.network.head.bias += torch.tensor([0.1, 0.3])
    found = drift.measure(policy)["drift_heldout"]
    assert found == pytest.approx((0.11 / 3) ** 0.5, rel=1e-4)
    assert HeldOut(policy, None).measure(policy) == {}


class Drawing:
    """A policy that starts from noise even where it does what is most likely."""

    in_keys = (keys.STATE,)

    def __call__(self, tensordict: TensorDict) -> TensorDict:
        return tensordict.set(keys.CHUNK, torch.randn(*tensordict.shape, 2, 1))


def test_asking_for_likely_chunks_leaves_the_random_numbers_as_they_were() -> None:
    frames = Frames().frames()
    before = torch.get_rng_state()
    first = likely_chunks(Drawing(), frames)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(1)
    assert torch.equal(likely_chunks(Drawing(), frames), first)


def test_measuring_what_is_held_out_leaves_the_random_numbers_as_they_were() -> None:
    policy = FlowPolicy(3, chunk=2, action_size=1, hidden=(4,))  # its loss draws noise
    before = torch.get_rng_state()
    held_out = HeldOut(policy, Frames())
    first = held_out.measure(policy)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(1)
    assert held_out.measure(policy) == first


def demonstrations(path: Path, *episodes: int) -> Any:
    return SimpleNamespace(meta=SimpleNamespace(path=path, episodes=episodes))


def test_held_out_episodes_that_the_anchor_is_trained_on_are_reported(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(logging.getLogger("rlco"), "propagate", True)
    heldout = demonstrations(tmp_path, 2, 3)
    for real in (None, demonstrations(tmp_path, 0, 1), demonstrations(Path(), 2)):
        warn_of_trained_on(real, heldout)
    assert not caplog.records
    warn_of_trained_on(demonstrations(tmp_path / ".", 0, 1, 2), heldout)
    assert f"trained on episodes 2 of {tmp_path}" in caplog.text


def test_held_out_episodes_of_nothing_are_refused() -> None:
    options = StageTwoOptions(policy="p", real_coeff=0.0, heldout_episodes="2-3")
    with pytest.raises(ConfigError, match="heldout_episodes=2-3 needs heldout_demos="):
        check_stage_two(options)
