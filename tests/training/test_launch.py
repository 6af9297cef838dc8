"""Where a training runs: what does not go together is refused at once."""

from __future__ import annotations

from typing import Any

import pytest

from rlco.errors import ConfigError
from rlco.training.launch import check_launch, own_options
from rlco.training.ranks import Ranks
from rlco.training.stage_two import StageTwoOptions

BY_TORCHRUN = {"TORCHELASTIC_RUN_ID": "here", "WORLD_SIZE": "4"}


def options(**given: Any) -> StageTwoOptions:
    return StageTwoOptions(policy="policy", **given)


@pytest.mark.parametrize(
    ("given", "started", "said"),
    [
        ({"launch": "torchrun"}, {}, "start torchrun --nproc-per-node=2"),
        ({}, BY_TORCHRUN, "torchrun has started 4 processes, and launch=local"),
        (
            {"launch": "torchrun", "minibatch": 126},
            BY_TORCHRUN,
            "minibatch=126 cannot be divided between 4 learners",
        ),
        (
            {"launch": "torchrun", "num_envs": 30},
            BY_TORCHRUN,
            "num_envs=30 cannot be divided between 4 learners",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(
    given: dict[str, Any],
    started: dict[str, str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in started.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=said):
        check_launch(options(**given))


@pytest.mark.parametrize(
    ("given", "started"),
    [
        ({}, {}),
        ({"num_envs": 31, "minibatch": 7}, {}),  # nothing is divided
        ({"launch": "torchrun"}, BY_TORCHRUN),
    ],
)
def test_what_goes_together_is_taken(
    given: dict[str, Any], started: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in started.items():
        monkeypatch.setenv(name, value)
    check_launch(options(**given))


def test_a_rank_has_its_part_of_what_all_have() -> None:
    given = options(num_envs=32, minibatch=64, real_rows=16, lr=0.5)
    own = own_options(given, Ranks(1, 4))
    assert (own.num_envs, own.minibatch, own.real_rows) == (8, 16, 4)
    assert own.lr == 0.5
    assert own_options(given, Ranks()) == given
