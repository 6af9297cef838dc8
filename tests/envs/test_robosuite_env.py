"""robosuite's tasks as TorchRL environments, and simulations that break."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs, step_mdp

from rlco.envs import make_env
from rlco.errors import RlcoError, SimulationError
from rlco.physics.robosuite.global_random import seeded
from rlco.physics.robosuite.tasks import make_plain

Backend = Literal["native", "robosuite"]
BACKENDS = pytest.mark.parametrize("backend", ["native", "robosuite"])
LIFT = "robosuite:Lift"


def actions(decisions: int, envs: int, chunk: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 2.0 * torch.rand(decisions, envs, chunk, 7, generator=generator) - 1.0


def play(env: Any, commands: torch.Tensor) -> TensorDictBase:
    """Reset, execute decisions, shape (T, N, H, 7); return what came next, (N, T)."""
    td = env.reset()
    out = []
    for command in commands:
        td = env.step(td.set("action", command))
        out.append(td["next"])
        td = step_mdp(td)
    return torch.stack(out, dim=1)


@BACKENDS
def test_what_it_returns_is_what_its_specs_say(backend: Backend) -> None:
    env = make_env(LIFT, num_envs=2, chunk=3, horizon=5, backend=backend)
    check_env_specs(env)
    # A tool's pose and two fingers; a cube's pose and its way from the tool.
    assert env.observation_spec["observation", "state"].shape == (2, 9)
    assert env.observation_spec["observation", "environment_state"].shape == (2, 10)
    assert len(env.task.description()["state_names"]) == 9
    assert len(env.task.description()["environment_state_names"]) == 10


@pytest.mark.parametrize("reward", ["shaped", "sparse"])
def test_both_backends_play_the_same_episodes(reward: Any) -> None:
    options: dict[str, Any] = {"num_envs": 2, "chunk": 3, "horizon": 5, "seed": 4}
    commands = actions(2, 2, 3)
    native = play(make_env(LIFT, reward=reward, **options), commands)
    slow = play(make_env(LIFT, reward=reward, backend="robosuite", **options), commands)
    for key in native.keys(include_nested=True, leaves_only=True):
        if key != "language_instruction":
            torch.testing.assert_close(native[key], slow[key], atol=1e-6, rtol=0)
    assert native["language_instruction"][0][0] == "lift the cube"
    assert native["truncated"].squeeze(-1).tolist() == [[False, True]] * 2
    assert bool((native["reward"] > 0).all()) == (reward == "shaped")


def test_an_episode_is_robosuites_of_its_seed() -> None:
    env = make_env(LIFT, num_envs=2, seed=7)
    first = env.reset()["observation"].clone()
    second = env.reset()["observation"]
    plain = make_plain("Lift")
    for index, seen in ((0, first[0]), (1, first[1]), (2, second[0]), (3, second[1])):
        with seeded(env.episode_seed(index)):
            expected = plain.reset()
        for key, name in (("environment_state", "object-state"),):
            np.testing.assert_allclose(seen[key], expected[name], atol=1e-6)
    assert not torch.equal(first["environment_state"], second["environment_state"])


def test_a_partial_reset_starts_the_next_episode_of_one_environment() -> None:
    env = make_env(LIFT, num_envs=2, seed=1)
    td = env.reset()
    td = env.step(td.set("action", actions(1, 2, 1)[0]))["next"]
    td["_reset"] = torch.tensor([[False], [True]])
    after = env.reset(td.clone())["observation", "environment_state"]
    other = make_env(LIFT, num_envs=2, seed=1)
    other.start_at(1)
    fresh = other.reset()["observation", "environment_state"]
    torch.testing.assert_close(after[1], fresh[1])
    torch.testing.assert_close(after[0], td["observation", "environment_state"][0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "robosuite:Lfit"}, "unknown robosuite environment .* 'Lift'"),
        ({"image_size": (64, 64)}, r"image_size=\(64, 64\) is not supported for"),
        ({"domain": "stand_in"}, "domain='stand_in' is not supported"),
        ({"variation": "shapes"}, "variation='shapes' is not supported"),
        ({"robosuite_options": {"robots": "IIWA"}}, "does not support IIWA"),
        (
            {"robosuite_options": {"robot": "UR5e"}},
            "unknown option of robosuite's Lift 'robot' .did you mean 'robots'",
        ),
        (
            {"robosuite_options": {"robots": "UR5"}},
            "unknown robot 'UR5' .did you mean 'UR5e'",
        ),
        ({"robosuite_options": {"robots": 5}}, "robots=5 is not allowed; give a name"),
        (
            {"robosuite_options": {"effects": 1}},
            "{'effects': 1} is not allowed; give effects= of make_env itself",
        ),
        (
            {"reward": "sparse", "robosuite_options": {"reward_shaping": True}},
            "{'reward_shaping': True} is not allowed; give reward='shaped' or",
        ),
        (
            {"robosuite_options": {"gripper_types": "Hand"}},
            "does not build Lift with the options .*gripper_types as given",
        ),
        (
            {
                "task": "robosuite:NutAssemblySquare",
                "robosuite_options": {"single_object_mode": 1},
            },
            "does not build NutAssemblySquare .*invalid set of arguments",
        ),
        ({"backend": "robosuite", "exact": True}, "exact=True is for backend='native'"),
        ({"backend": "robosuite", "threads": 2}, "threads=2 is for backend='native'"),
        ({"on_divergence": "ignore"}, "unknown on_divergence 'ignore'"),
        (
            {"task": "push_cube", "robosuite_options": {"robots": "UR5e"}},
            "robosuite_options= is for robosuite's own tasks",
        ),
    ],
)
def test_what_is_not_supported_is_refused(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(RlcoError, match=message) as caught:
        make_env(**{"task": LIFT, **options})
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")


@BACKENDS
@pytest.mark.parametrize(
    ("name", "robots"),
    [
        ("TwoArmLift", None),
        ("TwoArmLift", ["Panda", "Panda"]),
        ("Lift", ["Panda", "Panda"]),
    ],
)
def test_more_than_one_arm_is_refused_by_both_backends(
    name: str, robots: Any, backend: Backend
) -> None:
    options = {"robots": robots} if robots else None
    with pytest.raises(RlcoError, match=f"{name} has more than one arm") as caught:
        make_env(f"robosuite:{name}", backend=backend, robosuite_options=options)
    # No backend has it, so none is recommended.
    assert "backend=" not in str(caught.value)


def test_options_reach_robosuite() -> None:
    env = make_env(LIFT, robosuite_options={"robots": "UR5e", "control_freq": 10})
    assert env.task.control_frequency == 10
    assert env.backend.model.nq == 6 + 6 + 7  # six joints, six of a gripper, a cube
    inherited = {"control_freq": 10}  # taken by a base class's constructor
    square = make_env("robosuite:NutAssemblySquare", robosuite_options=inherited)
    assert square.task.control_frequency == 10


def test_exact_equals_robosuite_to_the_last_bit() -> None:
    commands = actions(2, 1, 3, seed=5)
    apart = []
    slow = make_env(LIFT, chunk=3, seed=4, backend="robosuite")
    play(slow, commands)
    for exact in (True, False):
        env = make_env(LIFT, chunk=3, seed=4, exact=exact)
        play(env, commands)
        apart.append(np.abs(env.backend.data[0].qpos - slow.backend.data[0].qpos).max())
    assert apart[0] == 0.0 < apart[1]


# -- A simulation that diverges ------------------------------------------------


def copies(env: Any) -> Any:
    return env.backend.data if hasattr(env, "backend") else env.stepper.data


@pytest.mark.slow
@pytest.mark.parametrize("fault", [float("nan"), 1e12])
@pytest.mark.parametrize(
    ("task", "backend"),
    [
        (LIFT, "native"),
        (LIFT, "robosuite"),
        ("push_cube", "native"),
        ("push_cube", "robosuite"),
    ],
)
def test_a_broken_simulation_is_cut_off_counted_and_reset(
    task: str,
    backend: Backend,
    fault: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file
    env = make_env(task, num_envs=2, chunk=2, horizon=20, backend=backend)
    td = env.reset()
    sound = td["observation"].clone()
    copies(env)[1].qvel[2] = fault
    with caplog.at_level(logging.WARNING):
        out, td = env.step_and_maybe_reset(td.set("action", actions(1, 2, 2)[0]))

    ended = out["next"]
    assert ended["diverged"].squeeze(-1).tolist() == [False, True]
    assert ended["truncated"].squeeze(-1).tolist() == [False, True]
    assert ended["done"].squeeze(-1).tolist() == [False, True]
    assert not ended["terminated"].any()
    assert ended["reward"][1] == 0.0
    assert env.divergences == 1
    assert "diverged (NaN) in environments [1]" in caplog.text
    if task == LIFT:  # its observations carry no sensor noise
        torch.testing.assert_close(ended["observation"][1], sound[1])
    # What comes next is a new episode, and it moves.
    assert not td["diverged"].any()
    out, td = env.step_and_maybe_reset(td.set("action", actions(1, 2, 2)[0]))
    assert not out["next", "diverged"].any()
    moved = out["next", "observation", "state"][1] - out["observation", "state"][1]
    assert 1e-4 < moved[:3].norm() < 0.2
    assert env.divergences == 1


@pytest.mark.parametrize("task", [LIFT, "push_cube"])
def test_a_broken_simulation_raises_where_that_is_asked(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    env = make_env(task, num_envs=2, on_divergence="raise")
    td = env.reset()
    copies(env)[0].qpos[0] = float("nan")
    with pytest.raises(SimulationError, match=r"environments \[0\]"):
        env.step(td.set("action", torch.zeros(2, 1, 7)))
