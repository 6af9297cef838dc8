"""The feature vector of low-dimensional observations."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from rlco.policies.nets.encoder import ObservationEncoder


def observation(instruction: int) -> TensorDict:
    """One observation with a state of 1 number and poses of 2."""
    return TensorDict(
        {
            "observation": {
                "state": torch.tensor([[0.5]]),
                "environment_state": torch.tensor([[-1.0, 2.0]]),
            },
            "instruction_id": torch.tensor([instruction]),
        },
        [1],
    )


def test_poses_are_repeated_in_the_place_of_the_instruction() -> None:
    """State, poses, poses for each of 3 instructions, one-hot instruction."""
    encoder = ObservationEncoder(1, environment_state_size=2, num_instructions=3)
    expected = [0.5, -1.0, 2.0, 0, 0, -1.0, 2.0, 0, 0, 0, 1, 0]
    assert encoder(observation(1)).tolist() == [expected]
    assert encoder.size == len(expected)


def test_one_linear_layer_can_pick_the_named_object() -> None:
    """With object k read at instruction k, weights alone select it."""
    encoder = ObservationEncoder(1, environment_state_size=2, num_instructions=2)
    pick = torch.zeros(encoder.size)
    pick[3 + 0] = 1.0  # the first number where instruction 0 is given,
    pick[3 + 2 + 1] = 1.0  # the second where instruction 1 is
    picked = [float(encoder(observation(k)) @ pick) for k in (0, 1)]
    assert picked == [-1.0, 2.0]


def test_without_an_instruction_poses_come_once() -> None:
    """There is nothing to pick them by."""
    encoder = ObservationEncoder(1, environment_state_size=2)
    assert encoder(observation(0)).tolist() == [[0.5, -1.0, 2.0]]
