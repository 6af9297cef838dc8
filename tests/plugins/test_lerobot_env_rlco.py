"""rlco's tasks under LeRobot's ``--env.type=rlco``."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import env_to_policy_features, preprocess_observation
from lerobot_env_rlco import RlcoEnv

from rlco.physics.tasks.gymnasium_env import TaskEnv


def test_lerobot_knows_the_type_and_its_features() -> None:
    config = EnvConfig.get_choice_class("rlco")(task="push_cube")
    features = env_to_policy_features(config)
    assert {name: feature.shape for name, feature in features.items()} == {
        "action": (7,),
        "observation.state": (7,),
        "observation.environment_state": (12,),
    }


@pytest.mark.slow
def test_copies_are_the_tasks_own_episodes() -> None:
    (copies,) = make_env(RlcoEnv(horizon=3), n_envs=2)["rlco"].values()
    observation, _ = copies.reset(seed=[4, 9])
    alone = TaskEnv("push_cube", horizon=3)
    first, _ = alone.reset(seed=9)
    np.testing.assert_array_equal(observation["agent_pos"][1], first["agent_pos"])
    action = np.full((2, 7), 3.0, np.float32)  # beyond the limits: clipped
    observation, *_ = copies.step(action)
    second, *_ = alone.step(np.ones(7, np.float32))
    np.testing.assert_array_equal(observation["agent_pos"][1], second["agent_pos"])
    assert copies.call("task_description")[1] == alone.task_description
    assert copies.call("_max_episode_steps") == (3, 3)
    copies.close()


def test_a_camera_has_lerobots_name() -> None:
    config = RlcoEnv(camera="front", image_size=32)
    assert env_to_policy_features(config)["observation.images.front"].shape == (
        3,
        32,
        32,
    )
    (copies,) = make_env(config, n_envs=1)["rlco"].values()
    observation, _ = copies.reset(seed=[0])
    seen = preprocess_observation(observation)
    assert seen["observation.images.front"].shape == (1, 3, 32, 32)
    assert float(seen["observation.images.front"].std()) > 0.01
    copies.close()


def test_several_cameras_have_lerobots_names_in_their_order() -> None:
    def frames(camera: str, cameras: str) -> dict[str, torch.Tensor]:
        config = RlcoEnv(camera=camera, cameras=cameras, image_size=32)
        (copies,) = make_env(config, n_envs=1)["rlco"].values()
        observation, _ = copies.reset(seed=[0])
        copies.close()
        return preprocess_observation(observation)

    both = frames("front,wrist", "agentview,robot0_eye_in_hand")
    for camera, view in (("front", "agentview"), ("wrist", "robot0_eye_in_hand")):
        name = f"observation.images.{camera}"
        assert torch.equal(both[name], frames(camera, view)[name])
    assert not torch.equal(
        *(both[f"observation.images.{n}"] for n in ("front", "wrist"))
    )


class _Solved(TaskEnv):
    """A task that is solved in its second step alone, or in the last one too."""

    solved_at: tuple[int, ...] = (2,)

    def _info(self, state: object) -> dict[str, object]:
        out = super()._info(state)
        return {**out, "is_success": self._elapsed in self.solved_at}


@pytest.mark.slow
@pytest.mark.parametrize(("solved_at", "expected"), [((2,), False), ((2, 3), True)])
def test_an_episode_counts_as_solved_at_its_end(
    solved_at: tuple[int, ...], expected: bool
) -> None:
    from lerobot_env_rlco.env import Episode

    task = _Solved("push_cube", horizon=3)
    task.solved_at = solved_at
    episode = Episode(task, {})
    episode.reset(seed=0)
    told = [episode.step(np.zeros(7))[-1]["is_success"] for _ in range(3)]
    assert told == [False, False, expected]
