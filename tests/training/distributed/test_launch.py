"""Where a training runs: what does not go together is refused at once."""

from __future__ import annotations

from typing import Any

import pytest

from rlco.errors import ConfigError
from rlco.training.distributed.launch import check_launch, own_options
from rlco.training.distributed.ranks import Ranks
from rlco.training.options.stage_two_options import StageTwoOptions

BY_TORCHRUN = {"TORCHELASTIC_RUN_ID": "here", "WORLD_SIZE": "4"}


def options(**given: Any) -> StageTwoOptions:
    return StageTwoOptions(policy="policy", **given)


@pytest.mark.parametrize(
    ("given", "started", "said"),
    [
        ({"launch": "torchrun"}, {}, "start torchrun --nproc-per-node=2"),
        ({}, BY_TORCHRUN, "torchrun has started 4 processes, and launch=local"),
        ({"launch": "ray", "workers": 2}, BY_TORCHRUN, "and launch=ray would train"),
        ({"launch": "ray"}, {}, "give workers=2"),
        ({"workers": 2}, {}, "workers belong to launch=ray"),
        ({"ray_address": "auto"}, {}, "ray_address belong to launch=ray"),
        ({"launch": "torchrun", "workers": 8}, BY_TORCHRUN, "with workers alone"),
        (
            {"launch": "torchrun", "ray_address": "auto"},
            BY_TORCHRUN,
            "with ray_address alone",
        ),
        (
            {"launch": "torchrun", "workers": 6, "ray_address": "a:1", "num_envs": 48},
            BY_TORCHRUN,
            "workers=6 cannot be divided between 4 learners",
        ),
        (
            {"launch": "torchrun", "minibatch": 126},
            BY_TORCHRUN,
            "minibatch=126 cannot be divided between 4 learners",
        ),
        (
            {"launch": "torchrun", "num_envs": 30},
            BY_TORCHRUN,
            "num_envs=30 cannot be divided between 4 processes",
        ),
        (
            {"launch": "ray", "workers": 3},
            {},
            "num_envs=32 cannot be divided between 3 processes",
        ),
        (
            {"launch": "ray", "workers": 8, "advantage": "mc"},
            {},
            "each of 8 processes 4 episodes, and group_size=8",
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
        ({"launch": "ray", "workers": 4, "advantage": "mc"}, {}),
        ({"launch": "torchrun"}, BY_TORCHRUN),
        ({"launch": "torchrun", "workers": 8, "ray_address": "auto"}, BY_TORCHRUN),
    ],
)
def test_what_goes_together_is_taken(
    given: dict[str, Any], started: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in started.items():
        monkeypatch.setenv(name, value)
    check_launch(options(**given))


def test_a_missing_ray_is_said_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"install rlco\[ray\]"):
        check_launch(options(launch="ray", workers=2))


def test_a_rank_has_its_part_of_what_all_have() -> None:
    given = options(num_envs=32, minibatch=64, real_rows=16, workers=8, lr=0.5)
    own = own_options(given, Ranks(1, 4))
    assert (own.num_envs, own.minibatch, own.real_rows, own.workers) == (8, 16, 4, 2)
    assert own.lr == 0.5
    assert own_options(given, Ranks()) == given
