"""The tasks as Gymnasium environments: its checks, seeds, ends, vectors, LeRobot."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium_cases import ID, actions, make
from torch import nn

import rlco.envs
from rlco import keys
from rlco.errors import RlcoError
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.tasks.gymnasium_env import TaskEnv
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.registration import gymnasium_id, register_tasks


@pytest.mark.slow
@pytest.mark.parametrize("task", TASK_NAMES)
def test_every_task_passes_gymnasiums_own_check(task: str) -> None:
    env = gymnasium.make(gymnasium_id(task))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    # Positions have no natural bounds; nothing else is remarked upon.
    messages = {str(warning.message) for warning in caught}
    assert all("infinity. This is probably too" in message for message in messages)


@pytest.mark.slow
def test_with_a_camera_it_passes_gymnasiums_own_check() -> None:
    env = make(
        obs_type="pixels_agent_pos", render_mode="rgb_array", image_size=(32, 40)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(env.unwrapped)
    observation, _ = env.reset(seed=0)
    assert observation["pixels"].shape == (32, 40, 3)
    # What is observed is what is rendered.
    np.testing.assert_array_equal(env.render(), observation["pixels"])


def test_unseen_lights_are_refused_where_nothing_would_show_them() -> None:
    with pytest.raises(RlcoError, match="changes images alone, but none are drawn"):
        TaskEnv("push_cube", variation="lights")
    with pytest.raises(RlcoError, match="lights sets the lights, but look=random"):
        TaskEnv("push_cube", variation="lights", look="random", render_mode="rgb_array")


def test_registering_again_changes_nothing() -> None:
    before = dict(gymnasium.registry)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register_tasks()
    assert dict(gymnasium.registry) == before


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_episodes_are_those_of_the_torchrl_environment(backend: Any) -> None:
    options: dict[str, Any] = {"domain": "stand_in", "horizon": 5, "backend": backend}
    env = make(**options)
    other = rlco.envs.make_env("push_cube", seed=7, **options)
    for episode in range(2):
        observation, info = env.reset(seed=7) if episode == 0 else env.reset()
        td = other.reset()
        reward, truncated = None, False
        for step, action in enumerate(actions(5, seed=episode)):
            assert observation["agent_pos"].tolist() == td[keys.STATE][0].tolist()
            assert (
                observation["environment_state"].tolist()
                == td[keys.ENVIRONMENT_STATE][0].tolist()
            )
            assert info["is_success"] == td[keys.SUCCESS].item()
            assert info["instruction_id"] == td[keys.INSTRUCTION_ID].item()
            text = env.get_wrapper_attr("task_description")
            assert text == td[keys.INSTRUCTION][0]
            observation, reward, terminated, truncated, info = env.step(action)
            td = other.step(td.set("action", torch.tensor(action).reshape(1, 1, 7)))
            td = td["next"]
            assert reward == pytest.approx(td["reward"].item(), abs=1e-6)
            assert (terminated, truncated) == (False, step == 4)
            assert truncated == td["truncated"].item()


def test_episodes_of_a_seed_can_be_named() -> None:
    env = make(horizon=2)
    starts = [env.reset(seed=3)[0], env.reset()[0], env.reset()[0]]
    again = env.reset(seed=3, options={"episode": 2})[0]
    np.testing.assert_array_equal(
        again["environment_state"], starts[2]["environment_state"]
    )
    assert (starts[1]["environment_state"] != starts[2]["environment_state"]).any()
    with pytest.raises(RlcoError, match="give 0 or more"):
        env.reset(options={"episode": -1})


def test_without_a_seed_two_environments_play_different_episodes() -> None:
    one, other = (make().reset()[0]["environment_state"] for _ in range(2))
    assert (one != other).any()


def play_expert(env: Any) -> list[tuple[bool, bool, bool]]:
    """Return (terminated, truncated, solved) of each step of the expert's episode."""
    env.reset(seed=1)
    inner: TaskEnv = env.unwrapped
    out = []
    while not (out and (out[-1][0] or out[-1][1])):
        action = inner._task.expert(inner.stepper.scene_state())[0]
        *_, terminated, truncated, info = env.step(action.astype(np.float32))
        out.append((terminated, truncated, info["is_success"]))
    return out


def test_success_ends_an_episode_only_where_it_is_asked_to() -> None:
    to_the_end = play_expert(make())
    assert len(to_the_end) == 120
    assert to_the_end[-1] == (False, True, True)
    solved = [row[2] for row in to_the_end].index(True)
    assert solved < 110

    stopped = play_expert(make(terminate_on_success=True))
    assert len(stopped) == solved + 1
    assert stopped[-1] == (True, False, True)
    assert not any(row[0] for row in stopped[:-1])


def test_a_vector_of_them_plays_what_single_ones_play() -> None:
    vector = gymnasium.make_vec(
        ID,
        num_envs=2,
        horizon=3,
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
    )
    vector.reset(seed=[4, 9])
    sequence = np.stack([actions(3, seed) for seed in (0, 1)], axis=1)
    for action in sequence:
        _, rewards, _, truncated, infos = vector.step(action)
    assert truncated.tolist() == [True, True]
    # A bool array: LeRobot reads it as one.
    assert infos["final_info"]["is_success"].dtype == np.bool_
    for index, seed in enumerate((4, 9)):
        env = make(horizon=3)
        env.reset(seed=seed)
        for action in sequence[:, index]:
            observation, reward, *_ = env.step(action)
        final = infos["final_obs"][index]
        assert reward == rewards[index]
        np.testing.assert_array_equal(
            final["environment_state"], observation["environment_state"]
        )


def test_exact_equals_robosuite_to_the_last_bit() -> None:
    sequence = actions(6, seed=2)
    found = []
    for options in ({"backend": "robosuite"}, {"exact": True}, {"exact": False}):
        env = make(**options)
        env.reset(seed=3)
        for action in sequence:
            env.step(action)
        found.append(env.unwrapped.stepper.data[0].qpos.copy())
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0] != found[2]).any()


class Expert(nn.Module):
    """LeRobot's interface of a policy, around the scripted expert."""

    def __init__(self, vector: Any) -> None:
        super().__init__()
        self.vector = vector
        self.told: list[str] = []

    def reset(self) -> None:
        """Start a rollout."""

    def select_action(self, batch: dict[str, Any]) -> torch.Tensor:
        """Return the expert's actions, (N, 7); check what the policy is given."""
        assert batch["observation.state"].shape == (2, 7)
        assert batch["observation.environment_state"].shape == (2, 12)
        self.told = batch["task"]
        envs = [env.unwrapped for env in self.vector.envs]
        rows = [env._task.expert(env.stepper.scene_state())[0] for env in envs]
        return torch.from_numpy(np.stack(rows)).float()


@pytest.mark.slow
def test_lerobots_own_rollout_reads_it() -> None:
    evaluation = pytest.importorskip("lerobot.scripts.lerobot_eval")
    from lerobot.processor import PolicyProcessorPipeline

    vector = gymnasium.vector.SyncVectorEnv(
        [lambda: gymnasium.make(ID)] * 2, autoreset_mode=AutoresetMode.SAME_STEP
    )
    policy = Expert(vector)
    observations: Any = PolicyProcessorPipeline(
        steps=[], to_transition=lambda x: x, to_output=lambda x: x
    )
    out = evaluation.rollout(
        vector, policy, *[observations] * 4, seeds=[1, 2], return_observations=False
    )
    # 120 steps, solved at the end, and told which cube.
    assert out["done"].shape == (2, 120)
    assert out["success"][:, -1].tolist() == [True, True]
    assert set(policy.told) <= set(vector.envs[0].unwrapped.instructions)
    assert vector.metadata["render_fps"] == 20


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"backend": "nativ"}, "unknown backend 'nativ' .*did you mean 'native'"),
        ({"obs_type": "pixels"}, "unknown obs_type 'pixels'"),
        ({"reward": "spare"}, "unknown reward 'spare' .*did you mean 'sparse'"),
        ({"render_mode": "human"}, "unknown render_mode 'human'"),
        ({"variation": "far"}, "unknown variation 'far'"),
        ({"domain": "stand_inn"}, "unknown domain .*did you mean 'stand_in'"),
        ({"horizon": 0}, "horizon=0 is not allowed; give 1 or more"),
        ({"image_size": (0, 3)}, r"image_size=\(0, 3\) is not allowed"),
        ({"image_quality": "best"}, "unknown image quality 'best'"),
        ({"image_quality": "robosuite"}, "'robosuite' is of no use without images"),
        ({"exact": True, "backend": "robosuite"}, "exact=True is for backend='native'"),
        (
            {
                "task": replace(make_task("push_cube"), variations=()),
                "variation": "shapes",
            },
            "unknown variation 'shapes'; known: none",
        ),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(RlcoError, match=message) as caught:
        TaskEnv(**{"task": "push_cube", **wrong})
    assert str(caught.value).endswith(".")


def test_an_action_of_another_shape_or_not_finite_is_refused() -> None:
    env = TaskEnv("push_cube")
    env.reset(seed=0)
    with pytest.raises(RlcoError, match=r"shape \(6,\); give \(7,\)"):
        env.step(np.zeros(6, dtype=np.float32))
    with pytest.raises(RlcoError, match="NaN or infinite"):
        env.step(np.full(7, np.nan, dtype=np.float32))
