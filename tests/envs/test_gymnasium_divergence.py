"""Gymnasium environments whose simulation diverges: cut off, counted, started anew."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium_cases import ID, actions, make

from rlco.physics.tasks.gymnasium_env import TaskEnv


@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_a_broken_simulation_is_cut_off_counted_and_reset(
    backend: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file
    env = make(backend=backend)
    env.reset(seed=5)
    sound, *_, info = env.step(actions(1)[0])
    assert info["diverged"] is False
    inner: TaskEnv = env.unwrapped
    inner.stepper.data[0].qvel[2] = np.nan
    with caplog.at_level(logging.WARNING):
        observation, reward, terminated, truncated, info = env.step(actions(1)[0])
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["diverged"] is True
    assert info["is_success"] is False
    for name, value in observation.items():
        np.testing.assert_array_equal(value, sound[name])
    assert inner.divergences == 1
    assert "simulation of 'push_cube' diverged" in caplog.text
    # The next episode is the seed's next, and sound.
    start, _ = env.reset()
    other = make(backend=backend)
    expected, _ = other.reset(seed=5, options={"episode": 1})
    np.testing.assert_array_equal(start["agent_pos"], expected["agent_pos"])
    *_, truncated, info = env.step(actions(1)[0])
    assert (truncated, info["diverged"], inner.divergences) == (False, False, 1)


def test_a_broken_simulation_shows_its_last_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    env = make(
        obs_type="pixels_agent_pos", render_mode="rgb_array", image_size=(16, 16)
    )
    sound, _ = env.reset(seed=5)
    env.unwrapped.stepper.data[0].qpos[0] = np.nan
    observation, *_ = env.step(actions(1)[0])
    np.testing.assert_array_equal(observation["pixels"], sound["pixels"])
    np.testing.assert_array_equal(env.render(), sound["pixels"])
    assert sound["pixels"].any()


def test_one_broken_simulation_leaves_the_rest_of_a_vector_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    vector = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="sync")
    vector.reset(seed=1)
    vector.envs[0].unwrapped.stepper.data[0].qpos[0] = np.nan
    step = np.stack([actions(1)[0]] * 2)
    _, rewards, _, truncated, infos = vector.step(step)
    assert truncated.tolist() == infos["diverged"].tolist() == [True, False]
    assert rewards[0] == 0.0 != rewards[1]
    # The vector resets it at its next step, and both go on.
    for _ in range(2):
        _, _, _, truncated, infos = vector.step(step)
        assert truncated.tolist() == infos["diverged"].tolist() == [False, False]
