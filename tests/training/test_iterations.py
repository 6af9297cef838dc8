"""The loop of Stage II: what happens in which order, and what is written when."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from rlco.training.iterations import co_train


class Diary:
    """A run, a collector and a learner that write down what is asked of them."""

    frames = 6
    path = Path()
    step = None

    def __init__(self, *, saved: Any = None, critic: Any = "critic") -> None:
        self.saved, self.critic = saved, critic
        self.happened: list[Any] = []

    # The run.
    def iterations(self, total: int, progress: Any = None) -> Iterator[int]:
        yield from range(1 if self.saved is None else self.saved + 1, total + 1)

    def load_checkpoint(self) -> Any:
        return self.saved

    def log_metrics(self, step: int, row: dict[str, Any]) -> None:
        self.happened.append(("row", step, dict(row)))

    def log_timings(self, step: int, row: dict[str, Any]) -> None:
        assert all(value >= 0 for value in row.values())

    def save_checkpoint(self, step: int, state: Any) -> Path:
        self.happened.append(("saved", step, state))
        return Path()

    # The collector.
    def collect(self, iteration: int) -> TensorDictBase:
        self.happened.append(("collected", iteration))
        reward = torch.tensor([[[1.0], [2.0]], [[0.5], [0.0]]])
        done = torch.tensor([[[True], [True]], [[True], [False]]])
        broken = torch.tensor([[[False], [True]], [[False], [False]]])
        played = {"reward": reward, "success": done, "diverged": broken}
        return TensorDict({"next": played}, [2, 2])

    # The learner.
    def load(self, state: Any) -> None:
        self.happened.append(("loaded", state))

    def state(self) -> str:
        return "state"

    def draw_own(self, rollout: int) -> None:
        pass  # a process alone draws as it did

    def anneal(self, done: float) -> None:
        self.happened.append(("annealed", done))

    def update(
        self,
        rollout: TensorDictBase,
        epochs: int,
        *,
        train_policy: bool,
        measure: bool,
    ) -> dict[str, float]:
        assert rollout.batch_size == (2, 2)
        self.happened.append(("updated", epochs, train_policy))
        if measure:
            self.happened.append(("measured the anchor",))
        return {"loss": 0.5}

    def check(self, rollout: TensorDictBase) -> None:
        self.happened.append(("checked", len(rollout)))


def options(**given: int) -> Any:
    return SimpleNamespace(
        **{"iterations": 2, "epochs": 3, "critic_iterations": 1, **given}
    )


def loop(diary: Any, **given: int) -> None:
    for iteration, row in co_train(
        options(**given), diary, diary, diary, check_first=diary.check
    ):
        diary.happened.append(("measured", iteration))
        row["success_sim"] = 0.25


def test_an_iteration_is_collected_learned_measured_written_and_saved() -> None:
    diary = Diary()
    loop(diary)
    row = {
        "return_mean": 1.75,  # (1 + 2 + 0.5 + 0) / 2
        "success_rollout": 0.5,  # at the end of an episode, not on the way
        "diverged": 1,
        "loss": 0.5,
        "success_sim": 0.25,
    }
    assert diary.happened == [
        ("annealed", 0.0),  # before the policy plays
        ("collected", 1),
        ("checked", 2),  # before anything is learned
        ("updated", 3, False),  # the critic alone
        ("measured", 1),
        ("row", 1, {"frames": 6, **row}),
        ("saved", 1, "state"),
        ("annealed", 0.5),
        ("collected", 2),
        ("updated", 3, True),
        ("measured", 2),
        ("row", 2, {"frames": 12, **row}),
        ("saved", 2, "state"),
    ]


def test_the_anchor_is_measured_in_the_iterations_asked_for() -> None:
    diary = Diary()
    for _ in co_train(
        options(), diary, diary, diary, check_first=diary.check, measure=(2).__eq__
    ):
        pass
    measured = diary.happened.index(("measured the anchor",))
    assert diary.happened.count(("measured the anchor",)) == 1
    assert diary.happened[measured - 1] == ("updated", 3, True)


def test_without_a_critic_the_policy_learns_from_the_first_rollout() -> None:
    diary = Diary(critic=None)
    loop(diary, critic_iterations=5)
    assert [e for e in diary.happened if e[0] == "updated"] == [
        ("updated", 3, True)
    ] * 2


def test_a_run_in_which_the_policy_never_learns_says_so(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger("rlco"), "propagate", True)
    for critic, alone in (("critic", 1), (None, 2)):
        loop(Diary(critic=critic), critic_iterations=alone)
    assert not caplog.records
    loop(Diary(), critic_iterations=2)
    assert "the policy stays as it was given" in caplog.text


def test_a_resumed_run_goes_on_after_its_checkpoint() -> None:
    diary = Diary(saved=1)
    loop(diary)
    assert diary.happened[:3] == [("loaded", 1), ("annealed", 0.5), ("collected", 2)]
    assert not [entry for entry in diary.happened if entry[0] == "checked"]


def test_what_ends_the_first_check_ends_the_loop() -> None:
    diary = Diary()

    def fail(rollout: TensorDictBase) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        next(co_train(options(), diary, diary, diary, check_first=fail))
    assert diary.happened == [("annealed", 0.0), ("collected", 1)]
