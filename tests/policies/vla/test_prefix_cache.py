"""Prefixes in batches, and what critics read of them."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.utils.flop_counter import FlopCounterMode
from transformers import DynamicCache
from vla_cases import rows, still

from rlco.errors import DataError
from rlco.policies.vla.prefix_cache import PREFIX, SUMMARY, Prefix, with_prefixes
from rlco.policies.vla.prefix_critic import add_next_summaries


def prefix(count: int = 3, layers: int = 2) -> Prefix:
    cache = DynamicCache()
    for layer in range(layers):
        cache.update(*torch.randn(2, count, 4, 5, 6).unbind(0), layer)
    mask = torch.rand(count, 5) > 0.3
    mask[:, 0] = True
    return Prefix.of(cache, mask, torch.randn(count, 5, 7))


def test_a_batch_gives_back_the_cache_that_was_written() -> None:
    made = prefix()
    td = TensorDict(batch_size=[3])
    made.write(td)
    again = Prefix.read(td[1:])
    assert again is not None
    for kept, given in zip(again.cache().layers, made.cache().layers, strict=True):
        assert torch.equal(kept.keys, given.keys[1:])
        assert torch.equal(kept.values, given.values[1:])
    assert torch.equal(again.mask, made.mask[1:])


def test_what_appends_to_a_cache_leaves_the_prefix_alone() -> None:
    made = prefix()
    before = made.keys.clone()
    cache = made.cache()
    cache.update(torch.ones(3, 4, 1, 6), torch.ones(3, 4, 1, 6), 0)
    assert cache.layers[0].keys.shape[2] == 6
    cache.layers[0].keys.zero_()
    assert torch.equal(made.keys, before)


def test_repeated_rows_follow_each_other() -> None:
    made = prefix(2)
    thrice = made.repeat(3)
    assert torch.equal(thrice.keys[:3], made.keys[:1].expand(3, -1, -1, -1, -1))
    assert torch.equal(thrice.mask[3:], made.mask[1:].expand(3, -1))


def test_the_memory_is_that_of_keys_and_values() -> None:
    assert prefix().bytes_per_row == 2 * (2 * 4 * 5 * 6) * 4


def test_parts_of_a_prefix_are_refused() -> None:
    td = TensorDict(batch_size=[3])
    prefix().write(td)
    assert Prefix.read(td.exclude(PREFIX)) is None
    with pytest.raises(DataError, match="lacks mask"):
        Prefix.read(td.exclude((PREFIX, "mask")))


def test_frames_carry_their_prefixes_in_place_of_images() -> None:
    policy, frames = still("smolvla"), rows(5)
    buffer = with_prefixes(frames, policy.prefix, rows=2)
    stored = buffer[:]
    assert ("observation", "image") not in stored.keys(True)
    torch.manual_seed(1)
    kept = policy.imitation_loss(stored)
    torch.manual_seed(1)
    torch.testing.assert_close(kept, policy.imitation_loss(frames))


def test_an_update_with_a_kept_prefix_needs_a_third_of_the_work() -> None:
    policy = still("pi05")
    td = policy(rows(4).exclude("vla_action"))

    def work(batch: TensorDict) -> int:
        with FlopCounterMode(display=False) as counter:
            dist = policy.get_dist(batch)
            dist.log_prob(batch["vla_action", "sample"]).sum().backward()
        return counter.get_total_flops()

    assert work(td) < work(td.exclude(PREFIX)) / 3


def test_the_next_observation_is_that_of_the_next_decision() -> None:
    policy = still("smolvla")
    episodes = rows(6).exclude("vla_action").reshape(2, 3)
    last = rows(2).exclude("vla_action")
    summary = policy.prefix(episodes.reshape(-1)).summary.reshape(2, 3, -1)
    rollout = episodes.clone().set(SUMMARY, summary)
    following = torch.stack([episodes[:, 1], episodes[:, 2], last], 1)
    rollout.set("next", following.clone())
    add_next_summaries(rollout, policy.new_summary)
    # As if every next observation had passed through the model.
    expected = policy.prefix(following.reshape(-1)).summary.reshape(2, 3, -1)
    torch.testing.assert_close(rollout["next", *SUMMARY], expected)
