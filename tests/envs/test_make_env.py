"""The tasks as TorchRL environments: specs, chunks, seeds, ends, resets, errors."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs, step_mdp

from rlco.envs import TabletopEnv, make_env
from rlco.errors import RenderingError
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.sensors import Sensors
from rlco.physics.spec.task import SceneState
from rlco.physics.tasks.make_task import make_task

Backend = Literal["native", "robosuite"]
BACKENDS = pytest.mark.parametrize("backend", ["native", "robosuite"])
QUIET = Domain(
    "quiet", sensors=Sensors(object_noise=0.0)
)  # sensors and camera without noise


def play(env: TabletopEnv, actions: torch.Tensor) -> TensorDictBase:
    """Reset, execute decisions, shape (T, N, H, 7); return what came next, (N, T)."""
    td = env.reset()
    out = []
    for action in actions:
        td = env.step(td.set("action", action))
        out.append(td["next"])
        td = step_mdp(td)
    return torch.stack(out, dim=1)


def random_actions(decisions: int, envs: int, chunk: int, seed: int = 0) -> Any:
    generator = torch.Generator().manual_seed(seed)
    return 2.0 * torch.rand(decisions, envs, chunk, 7, generator=generator) - 1.0


@BACKENDS
def test_what_it_returns_is_what_its_specs_say(backend: Backend) -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=8, backend=backend)
    check_env_specs(env)
    assert env.action_spec.shape == (2, 4, 7)


def test_one_environment_has_a_batch_of_one() -> None:
    td = make_env("push_cube", horizon=2).rollout(2)
    assert td.batch_size == (1, 2)
    assert td["action"].shape == (1, 2, 1, 7)
    assert td["next", "reward"].shape == (1, 2, 1)


@pytest.mark.parametrize("reward", ["shaped", "sparse"])
def test_a_chunk_of_four_equals_four_chunks_of_one(reward: Any) -> None:
    options: dict[str, Any] = {"num_envs": 3, "domain": QUIET, "reward": reward}
    actions = random_actions(3, 3, 4)
    four = make_env("push_cube", chunk=4, **options)
    coarse = play(four, actions)
    single = make_env("push_cube", chunk=1, **options)
    fine = play(single, actions.transpose(1, 2).reshape(12, 3, 1, 7))

    sums = fine["reward"].reshape(3, 3, 4, 1).sum(2)
    torch.testing.assert_close(coarse["reward"], sums, atol=1e-6, rtol=0)
    for one, other in zip(four.stepper.data, single.stepper.data, strict=True):
        assert np.abs(one.qpos - other.qpos).max() <= 1e-12


def test_the_last_decision_executes_and_earns_what_is_left_of_the_horizon() -> None:
    # Horizon 6 in chunks of 4: 4 control steps, then 2.
    actions = random_actions(2, 2, 4, seed=1)
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=6, domain=QUIET)
    coarse = play(env, actions)
    assert [data.time for data in env.stepper.data] == pytest.approx([0.3, 0.3])
    single = make_env("push_cube", num_envs=2, chunk=1, horizon=6, domain=QUIET)
    fine = play(single, actions.transpose(1, 2).reshape(8, 2, 1, 7)[:6])

    earned = fine["reward"].squeeze(-1)
    expected = torch.stack([earned[:, :4].sum(1), earned[:, 4:].sum(1)], 1)
    got = coarse["reward"].squeeze(-1)
    torch.testing.assert_close(got, expected, atol=1e-6, rtol=0)
    assert coarse["truncated"].squeeze(-1).tolist() == [[False, True]] * 2


@BACKENDS
def test_steps_that_are_not_executed_earn_nothing(backend: Backend) -> None:
    def one(before: SceneState, after: SceneState) -> Any:
        return np.ones(after.instruction_id.shape)

    task = replace(make_task("push_cube"), shaped_reward=one)
    env = make_env(task, num_envs=2, chunk=4, horizon=6, backend=backend)
    earned = env.rollout(2)["next", "reward"].squeeze(-1)
    # One a control step: 4 of the first decision, 2 of the second.
    assert earned.tolist() == [[4.0, 2.0]] * 2


@BACKENDS
def test_episodes_are_truncated_at_the_horizon_and_never_terminated(
    backend: Backend,
) -> None:
    env = make_env("push_cube", num_envs=2, horizon=5, backend=backend)
    td = env.rollout(9)  # stops by itself
    assert td.batch_size == (2, 5)
    expected = [[False] * 4 + [True]] * 2
    assert td["next", "truncated"].squeeze(-1).tolist() == expected
    assert td["next", "done"].squeeze(-1).tolist() == expected
    assert not td["next", "terminated"].any()


def test_success_does_not_end_an_episode() -> None:
    env = make_env("push_cube", num_envs=4, seed=3)
    state = env.reset()
    solved = []
    for _ in range(env.horizon - 1):
        action = env.task.expert(env.stepper.scene_state())
        state = env.step(state.set("action", torch.tensor(action[:, None]).float()))
        state = state["next"]
        solved.append(state["success"].squeeze(-1))
        assert not state["done"].any()
    # Solved well before the end, and the episodes went on.
    assert torch.stack(solved)[:-20].any(0).all()


def test_a_seed_gives_the_same_episode_again_exactly() -> None:
    actions = random_actions(3, 2, 2)

    def episode(seed: int) -> TensorDictBase:
        env = make_env("push_cube", num_envs=2, chunk=2, domain="stand_in", seed=seed)
        return play(env, actions).exclude("language_instruction")

    first, again, other = episode(7), episode(7), episode(8)
    assert (first == again).all()
    key = ("observation", "environment_state")
    assert not torch.equal(first[key], other[key])


def test_set_seed_starts_that_seed_over() -> None:
    env = make_env("push_cube", num_envs=2, seed=4)
    fresh = env.reset()["observation", "environment_state"]
    env.reset()
    env.set_seed(4)
    torch.testing.assert_close(
        env.reset()["observation", "environment_state"], fresh, atol=0, rtol=0
    )


@pytest.mark.slow
def test_the_first_episodes_of_a_seed_do_not_depend_on_the_batch() -> None:
    def first_six(num_envs: int) -> tuple[torch.Tensor, list[int], list[str]]:
        env = make_env("push_cube", num_envs=num_envs, seed=11, domain="stand_in")
        seen, ids, texts = [], [], []
        for _ in range(6 // num_envs):
            td = env.reset()
            seen.append(td["observation", "environment_state"])
            ids += td["instruction_id"].tolist()
            texts += list(td["language_instruction"])
        return torch.cat(seen), ids, texts

    reference = first_six(6)
    for num_envs in (1, 2, 3):
        seen, ids, texts = first_six(num_envs)
        assert torch.equal(seen, reference[0])
        assert ids == reference[1]
        assert texts == reference[2]
    # The text says what the id says.
    task = make_env("push_cube").task
    assert reference[2] == [task.instructions[i] for i in reference[1]]
    assert len(set(reference[1])) > 1


def test_start_at_names_the_episode_that_comes_next() -> None:
    env = make_env("push_cube", num_envs=2, seed=1)
    episodes = [env.reset()["observation", "environment_state"] for _ in range(4)]
    env.start_at(2)
    assert torch.equal(env.reset()["observation", "environment_state"], episodes[2])
    assert torch.equal(env.reset()["observation", "environment_state"], episodes[3])


@BACKENDS
def test_a_partial_reset_leaves_the_others_alone(backend: Backend) -> None:
    env = make_env("push_cube", num_envs=3, horizon=9, seed=2, backend=backend)
    td = play(env, random_actions(2, 3, 1))[:, -1]
    before = [data.qpos.copy() for data in env.stepper.data]
    td["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(td.clone())

    for index in (0, 2):
        np.testing.assert_array_equal(env.stepper.data[index].qpos, before[index])
        for key in ("state", "environment_state"):
            key = ("observation", key)
            assert torch.equal(after[key][index], td[key][index])
    # The second environment plays its next episode: number 1 * 3 + 1 of the seed.
    single = make_env("push_cube", num_envs=1, seed=2, backend=backend)
    single.start_at(4)
    key = ("observation", "environment_state")
    assert torch.equal(after[key][1], single.reset()[key][0])
    # Its clock starts over, theirs go on: 7 more steps end theirs alone.
    for _ in range(7):
        after = env.step(after.set("action", torch.zeros(3, 1, 7)))["next"]
    assert after["truncated"].squeeze(-1).tolist() == [True, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("domain", ["sim", "stand_in", "locked"])
def test_both_backends_report_the_same(domain: str) -> None:
    actions = random_actions(3, 2, 4, seed=3)
    actions[..., :3] *= 0.3
    actions[..., 2] = 0.5  # up, away from the cubes
    actions[..., 6] = 1.0
    native, robosuite = (
        play(
            make_env("push_cube", num_envs=2, chunk=4, domain=domain, backend=b),
            actions,
        )
        for b in ("native", "robosuite")
    )
    for key in (
        ("observation", "state"),
        ("observation", "environment_state"),
        "reward",
    ):
        torch.testing.assert_close(native[key], robosuite[key], atol=1e-5, rtol=0)
    for key in ("success", "done", "instruction_id"):
        assert torch.equal(native[key], robosuite[key])


def test_exact_equals_robosuite_to_the_last_bit() -> None:
    actions = random_actions(2, 2, 4, seed=5)
    slow = make_env("push_cube", num_envs=2, chunk=4, seed=1, backend="robosuite")
    play(slow, actions)
    for exact in (True, False):
        env = make_env("push_cube", num_envs=2, chunk=4, seed=1, exact=exact)
        play(env, actions)
        pairs = zip(env.stepper.data, slow.stepper.data, strict=True)
        same = [np.array_equal(one.qpos, other.qpos) for one, other in pairs]
        assert same == [exact] * 2


# -- Images --------------------------------------------------------------------


def image_env(**options: Any) -> TabletopEnv:
    try:
        return make_env("push_cube", num_envs=2, image_size=(48, 64), **options)
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")


@pytest.mark.slow
@BACKENDS
def test_images_show_the_scene(backend: Backend) -> None:
    env = image_env(horizon=3, backend=backend)
    check_env_specs(env)
    first = env.reset()["observation", "image"]
    assert first.shape == (2, 3, 48, 64)
    assert first.dtype == torch.uint8
    # Two episodes begin with cubes at different places.
    assert (first[0] != first[1]).any()
    # Something red, something green and something blue lie on the table.
    pixels = first.float()
    for colour in range(3):
        rest = pixels[:, [c for c in range(3) if c != colour]].amax(1)
        assert (pixels[:, colour] > 1.8 * rest).any()
    # The robot rises: the image changes where it was.
    action = torch.zeros(2, 1, 7)
    action[..., 2] = 1.0
    second = play(env, action.expand(3, 2, 1, 7))["observation", "image"][:, -1]
    assert (second != first).any()


@pytest.mark.parametrize("library", ["glfw", "nonsense"])
def test_without_a_gl_library_the_message_names_the_packages(library: str) -> None:
    # In a process of its own: MuJoCo loads its library at import. GLFW without a
    # display is what a server without OpenGL libraries falls back to.
    script = (
        "from rlco.errors import RenderingError\n"
        "try:\n"
        "    from rlco.physics.rendering.camera import Camera, mujoco\n"
        "    Camera(mujoco.MjModel.from_xml_string('<mujoco/>'), (32, 32))\n"
        "except RenderingError as error:\n"
        "    print(error)\n"
    )
    variables = {k: v for k, v in os.environ.items() if "DISPLAY" not in k}
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**variables, "MUJOCO_GL": library},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert f"cannot render with MUJOCO_GL='{library}'" in done.stdout
    assert "libegl1 libgl1-mesa-dri libosmesa6" in done.stdout
