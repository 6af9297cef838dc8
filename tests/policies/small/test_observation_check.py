"""What a policy on a robot is given: NaN is refused, another unit is reported."""

from __future__ import annotations

import copy
import logging
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.errors import CheckpointError, DataError
from rlco.policies import GaussianPolicy, load_policy, save_policy

NAMES = ["shoulder", "elbow", "gripper"]


@pytest.fixture
def loaded(tmp_path: Path) -> Any:
    policy = GaussianPolicy(
        3, chunk=2, action_size=3, num_instructions=2, hidden=(4,), action_limit=None
    )
    # Degrees; the gripper never moved.
    state = ([-90.0, 40.0, 12.0], [-10.0, 100.0, 12.0])
    policy.set_normalization(state=state, action=state)
    save_policy(policy, tmp_path / "run" / "policy", extra={"state_names": NAMES})
    return load_policy(tmp_path / "run" / "policy")[0]


def act(policy: Any, *state: float, instruction: Any = 0) -> torch.Tensor:
    td = TensorDict(
        {
            "observation": {"state": torch.tensor([state])},
            "instruction_id": torch.tensor([instruction]),
        },
        [1],
    )
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        action: torch.Tensor = policy(td)["action"]
    return action


@pytest.mark.parametrize("wrong", [torch.nan, torch.inf, -torch.inf])
def test_an_observation_that_is_not_finite_gets_no_action(
    loaded: Any, wrong: float
) -> None:
    with pytest.raises(DataError, match=rf"is {wrong} under 'elbow'.*stop the robot"):
        act(loaded, -50.0, wrong, 12.0)


def test_observations_like_the_data_are_answered_in_silence(
    loaded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "rlco"):
        act(loaded, -50.0, 70.0, 12.0)
        # 100 is the 99 % quantile, 130 is half of the range of 60 beyond it.
        act(loaded, -10.0, 129.9, 12.005)
    assert not caplog.records


def test_radians_for_degrees_are_reported_once_with_value_and_range(
    loaded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "rlco"):
        for _ in range(2):
            act(loaded, -0.9, 1.2, 0.21)
        act(loaded, 170.0, 1.2, 0.21)
    first, second = [record.getMessage() for record in caplog.records]
    assert "elbow is 1.2, data 40 to 100" in first
    assert "gripper is 0.21, data 11.99 to 12.01" in first
    assert "shoulder" not in first  # -0.9 is near enough to -10
    assert "shoulder is 170, data -90 to -10" in second
    assert "elbow" not in second


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))]
)
def test_a_copy_of_a_policy_looks_at_its_own_range(
    loaded: Any, caplog: pytest.LogCaptureFixture, copied: Any
) -> None:
    other = copied(loaded)
    other.set_normalization(state=([0.0] * 3, [1.0] * 3))
    with caplog.at_level(logging.WARNING, "rlco"):
        act(other, 0.5, 0.5, 12.0)
    assert "gripper is 12, data 0 to 1)" in caplog.records[0].getMessage()
    with pytest.raises(DataError, match="elbow"):
        act(other, 0.5, torch.nan, 0.5)


def test_a_batch_names_what_is_worst(
    loaded: Any, caplog: pytest.LogCaptureFixture
) -> None:
    state = torch.tensor([[-50.0, 70.0, 12.0], [-50.0, 500.0, 12.0]])
    given = {"observation": {"state": state}, "instruction_id": torch.tensor([0, 1])}
    with caplog.at_level(logging.WARNING, "rlco"):
        loaded(TensorDict(given, [2]))
    assert "elbow is 500" in caplog.records[0].getMessage()


@pytest.mark.parametrize("wrong", [2, -1, 0.5])
def test_an_instruction_that_there_is_not_is_refused(loaded: Any, wrong: Any) -> None:
    with pytest.raises(DataError, match=rf"instruction_id is {wrong} .*from 0 to 1"):
        act(loaded, -50.0, 70.0, 12.0, instruction=wrong)


def test_a_runs_folder_is_not_its_policy(loaded: Any, tmp_path: Path) -> None:
    meant = str(tmp_path / "run" / "policy")
    for given in ("run", ".", "run/policy/policy.json"):
        with pytest.raises(CheckpointError) as caught:
            load_policy(tmp_path / given)
        assert f"such as {meant!r}." in str(caught.value)
    with pytest.raises(CheckpointError) as caught:
        load_policy(tmp_path / "nowhere")
    assert "such as" not in str(caught.value)


@pytest.mark.parametrize(
    ("images", "advice", "never"),
    [
        (torch.zeros(1, 84, 84, 3, dtype=torch.uint8), ["movedim(-1, -3)"], ["resize"]),
        (torch.zeros(1, 3, 96, 96, dtype=torch.uint8), ["resized("], ["movedim"]),
        (torch.zeros(1, 3, 84, 84), ["(255 * image)"], ["resize", "movedim"]),
        (
            torch.zeros(1, 96, 128, 3, dtype=torch.float64),
            ["(255 * image)", "movedim(-1, -3)", "resized(images, (84, 84))"],
            [],
        ),
        (torch.zeros(1, 1, 84, 84, dtype=torch.uint8), ["RGB"], ["movedim"]),
    ],
)
def test_images_of_another_form_get_the_advice_that_fits(
    images: torch.Tensor, advice: list[str], never: list[str]
) -> None:
    policy = GaussianPolicy(
        2, chunk=1, hidden=(4,), image={"kind": "conv", "size": (84, 84)}
    )
    seen = {"observation": {"state": torch.zeros(1, 2), "image": images}}
    with pytest.raises(DataError, match=r"torch\.uint8 of shape") as caught:
        policy(TensorDict(seen, [1]))
    for words in advice:
        assert words in str(caught.value)
    for words in never:
        assert words not in str(caught.value)
    # Following it is enough.
    if images.shape[1] == 1:
        return
    from rlco.data.resize import resized

    if images.is_floating_point():
        images = (255 * images).round().to(torch.uint8)
    if images.shape[1] != 3:
        images = images.movedim(-1, -3)
    seen["observation"]["image"] = resized(images, (84, 84))
    policy(TensorDict(seen, [1]))
