"""Other environments under rlco's keys: numbers by hand, and round trips."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from other_envs import Counter, libero_lift
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, GymEnv, GymWrapper, SerialEnv, set_gym_backend
from torchrl.envs.custom import ToyVLAEnv
from torchrl.envs.custom.mujoco import Walker2dEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from rlco import keys
from rlco.envs import (
    canonical,
    from_gymnasium,
    from_mujoco,
    from_vla,
    make_env,
)
from rlco.errors import RlcoError


def play(env: EnvBase, td: TensorDictBase, actions: torch.Tensor) -> TensorDictBase:
    """Execute decisions, shape (T, N, H, A), from a reset; what came next, (N, T)."""
    out = []
    for action in actions:
        td = env.step(td.set("action", action))
        out.append(td["next"])
        td = step_mdp(td)
    return torch.stack(out, dim=1)


def random_actions(*shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return 2.0 * torch.rand(*shape, generator=generator) - 1.0


def near(distance: float, td: TensorDictBase) -> torch.Tensor:
    return td[keys.STATE][..., 0] > distance


# -- A Gymnasium environment whose numbers can be told in advance ---------------


@pytest.mark.parametrize("chunk", [1, 2])
def test_entries_are_those_of_rlcos_own_environments(chunk: int) -> None:
    env = from_gymnasium(Counter, num_envs=3, chunk=chunk)
    check_env_specs(env)
    own = make_env("push_cube", num_envs=3, chunk=chunk).observation_spec
    for key in (keys.STATE, keys.INSTRUCTION_ID, keys.SUCCESS):
        spec = env.observation_spec[key]
        assert spec.dtype == own[key].dtype
        assert spec.ndim == own[key].ndim
    assert env.action_spec.shape == (3, chunk, 1)


def test_a_chunks_reward_is_the_sum_of_its_executed_steps() -> None:
    env = from_gymnasium(Counter, num_envs=2, chunk=4)
    # Actions -1, 0, 1 are -2, 1, 4 of [-2, 4]. Five steps: four, then one.
    action = torch.tensor([-1.0, 0.0, 1.0, 1.0]).reshape(1, 1, 4, 1).expand(2, 2, 4, 1)
    out = play(env, env.reset(), action)
    assert out["reward"].squeeze(-1).tolist() == [[7.0, -2.0]] * 2
    assert out["truncated"].squeeze(-1).tolist() == [[False, True]] * 2
    assert not out["terminated"].any()
    # The observation is the last one that was reached.
    assert out[keys.STATE][0, :, 0].tolist() == [4.0, 5.0]
    assert out[keys.STATE].dtype == torch.float32


def test_an_episode_that_ends_within_a_chunk_leaves_the_others_going() -> None:
    horizons = iter([7, 2, 7, 7])  # the first one is only looked at
    env = canonical(
        lambda: GymWrapper(Counter(next(horizons))),
        state=["observation"],
        success=partial(near, 2.5),
        num_envs=2,
        chunk=4,
    )
    td = env.reset()
    td = env.step(td.set("action", torch.ones(2, 4, 1)))
    # Two steps of 4, and four.
    assert td["next", "reward"].squeeze(-1).tolist() == [8.0, 16.0]
    assert td["next", "truncated"].squeeze(-1).tolist() == [True, False]
    assert td["next", keys.STATE][:, 0].tolist() == [2.0, 4.0]
    assert td["next", keys.SUCCESS].squeeze(-1).tolist() == [False, True]
    # The one that ended starts over, the other goes on for its last three.
    td = env.maybe_reset(td["next"])
    td = env.step(td.set("action", torch.ones(2, 4, 1)))
    assert td["next", keys.STATE][:, 0].tolist() == [2.0, 7.0]
    assert td["next", "reward"].squeeze(-1).tolist() == [8.0, 12.0]


def test_rollouts_go_on_across_episodes() -> None:
    env = from_gymnasium(Counter, num_envs=2, chunk=4)
    rollout = env.rollout(4, break_when_any_done=False)
    # Episodes of five steps: four and one, twice.
    assert rollout["next", keys.STATE][0, :, 0].tolist() == [4.0, 5.0, 4.0, 5.0]
    ends = rollout["next", "done"].squeeze(-1)
    assert ends.tolist() == [[False, True, False, True]] * 2


def test_success_is_read_from_info_and_absent_from_a_reset() -> None:
    env = from_gymnasium(Counter)
    td = env.reset()
    assert td[keys.SUCCESS].tolist() == [[False]]
    out = play(env, td, torch.zeros(4, 1, 1, 1))
    assert out[keys.SUCCESS].flatten().tolist() == [False, False, True, False]


def test_where_nothing_says_success_a_function_must() -> None:
    make = partial(Counter, tells=False)
    with pytest.raises(RlcoError, match=r"nor 'success' but.*; give success="):
        from_gymnasium(make)
    env = from_gymnasium(make, success=partial(near, 1.5))
    out = play(env, env.reset(), torch.zeros(3, 1, 1, 1))
    assert out[keys.SUCCESS].flatten().tolist() == [False, True, True]


def test_a_horizon_truncates_earlier_than_the_environment_itself() -> None:
    env = from_gymnasium(partial(Counter, 5), horizon=3, chunk=2)
    out = play(env, env.reset(), torch.zeros(2, 1, 2, 1))
    assert out["truncated"].flatten().tolist() == [False, True]
    assert out[keys.STATE][0, :, 0].tolist() == [2.0, 3.0]


def test_gymnasiums_mujoco_tasks_step_as_they_do_by_themselves() -> None:
    def reached(td: TensorDictBase) -> torch.Tensor:
        return td[keys.STATE][..., -2:].norm(dim=-1) < 0.05

    env = from_gymnasium("Reacher-v5", success=reached, chunk=3)
    td = env.reset(list_of_kwargs=[{"seed": 5}])
    actions = random_actions(4, 1, 3, 2)
    out = play(env, td, actions)

    plain = gymnasium.make("Reacher-v5")
    plain.reset(seed=5)
    for t in range(4):
        total = 0.0
        for action in actions[t, 0]:
            observation, reward, *_ = plain.step(action.numpy())
            total += float(reward)
        np.testing.assert_array_equal(
            out[keys.STATE][0, t], observation.astype(np.float32)
        )
        assert out["reward"][0, t].item() == pytest.approx(total, abs=1e-5)


def test_actions_cover_the_environments_own_range() -> None:
    env = from_gymnasium("Pendulum-v1", success=partial(near, 0.95))
    td = env.reset(list_of_kwargs=[{"seed": 1}])
    out = play(env, td, torch.full((1, 1, 1, 1), -1.0))
    with set_gym_backend("gymnasium"):
        plain = GymEnv("Pendulum-v1")
    td = plain.reset(seed=1)
    expected = plain.step(td.set("action", torch.tensor([-2.0])))["next", "observation"]
    assert torch.equal(out[keys.STATE][0, 0], expected)


# -- rlco's own tasks, there and back -------------------------------------------


def both_ways(**options: Any) -> tuple[TensorDictBase, TensorDictBase]:
    """Two environments of a seed, directly and by way of Gymnasium: (N, T) each."""
    shared = {k: v for k, v in options.items() if k not in ("image_size",)}
    chunk = options["chunk"]
    actions = random_actions(3, 2, chunk, 7)
    own = make_env("push_cube", num_envs=2, seed=6, **options)
    direct = play(own, own.reset(), actions)
    if "image_size" in options:
        shared |= {"obs_type": "pixels_agent_pos", "image_size": options["image_size"]}
    env = from_gymnasium("rlco/PushCube-v0", num_envs=2, **shared)
    starts = [{"seed": 6, "options": {"episode": episode}} for episode in range(2)]
    around = play(env, env.reset(list_of_kwargs=starts), actions)
    return direct, around


@pytest.mark.slow
@pytest.mark.parametrize("reward", ["shaped", "sparse"])
@pytest.mark.parametrize("chunk", [pytest.param(1, marks=pytest.mark.thorough), 4])
def test_by_way_of_gymnasium_the_same_comes_out(chunk: int, reward: str) -> None:
    from rlco.physics.effects import AppliedEffect
    from rlco.physics.spec.domain import Domain
    from rlco.physics.spec.sensors import Sensors

    # Noise is drawn for each decision: chunks of more than one step see another.
    slip = AppliedEffect("scene_friction", None, {"factor": 0.7})
    quiet = Domain("quiet", (slip,), Sensors(object_noise=0.0))
    domain = "stand_in" if chunk == 1 else quiet
    direct, around = both_ways(chunk=chunk, domain=domain, reward=reward)
    for key in (keys.STATE, keys.ENVIRONMENT_STATE):
        assert torch.equal(around[key], direct[key])
    for name in ("success", "done", "truncated", "terminated", "instruction_id"):
        assert torch.equal(around[name], direct[name])
        assert around[name].dtype == direct[name].dtype
    torch.testing.assert_close(around["reward"], direct["reward"], atol=1e-6, rtol=0)
    assert list(around[:, 0][keys.INSTRUCTION]) == list(direct[:, 0][keys.INSTRUCTION])


def test_by_way_of_gymnasium_the_last_chunk_ends_at_the_horizon() -> None:
    direct, around = both_ways(chunk=4, horizon=10)
    assert around["truncated"].squeeze(-1).tolist() == [[False, False, True]] * 2
    torch.testing.assert_close(around["reward"], direct["reward"], atol=1e-6, rtol=0)
    torch.testing.assert_close(around[keys.STATE], direct[keys.STATE], atol=0, rtol=0)


@pytest.mark.slow
@pytest.mark.usefixtures("rendering")
def test_by_way_of_gymnasium_the_same_is_seen() -> None:
    direct, around = both_ways(chunk=2, image_size=(24, 32))
    assert torch.equal(around[keys.IMAGE], direct[keys.IMAGE])


# -- TorchRL's own environments --------------------------------------------------


@pytest.mark.parametrize("batch", [[], [3]])
def test_the_toy_with_an_oracle_is_solved_and_terminated(batch: list[int]) -> None:
    toy = ToyVLAEnv(2, 4, success_steps=2, batch_size=batch, seed=0)
    env = from_vla(lambda: toy, horizon=6, chunk=3)
    check_env_specs(env)
    td = env.reset()
    assert td[keys.INSTRUCTION][0] == "push the T-shaped block onto the target"
    assert (td[keys.INSTRUCTION_ID] == 0).all()
    oracle = td[keys.STATE][:, None, 2:4].expand(-1, 3, -1)
    off = oracle + torch.tensor([[0.1, 0.0], [0.0, 0.2], [9.0, 9.0]])
    out = env.step(td.set("action", off))["next"]
    # In tolerance twice: solved after two steps, the third is not executed.
    torch.testing.assert_close(out["reward"], torch.full_like(out["reward"], -0.3))
    assert out["success"].all()
    assert out["terminated"].all()


def test_the_toy_without_a_target_does_not_say_success() -> None:
    with pytest.raises(RlcoError, match=r"does not say when it is solved.*success="):
        from_vla(ToyVLAEnv, horizon=5)


def test_texts_and_ids_agree_and_others_are_refused() -> None:
    toy = ToyVLAEnv(2, 4, instruction="b", success_steps=1, batch_size=[2])
    env = from_vla(lambda: toy, instructions=["a", "b"], horizon=5)
    assert env.reset()[keys.INSTRUCTION_ID].tolist() == [1, 1]
    with pytest.raises(RlcoError, match=r"gives the instruction 'b'.*add it"):
        from_vla(lambda: toy, instructions=["a", "c"], horizon=5).reset()


def test_torchrls_mujoco_tasks_step_as_they_do_by_themselves() -> None:
    make = partial(Walker2dEnv, backend="mujoco", seed=3, max_episode_steps=7)
    env = from_mujoco(make, success=partial(near, 1.2), num_envs=2, chunk=2)
    check_env_specs(env)
    env = from_mujoco(make, success=partial(near, 1.2), num_envs=2, chunk=2)
    td, plain = env.reset(), make()
    other = plain.reset()
    assert torch.equal(td[keys.STATE][0], other["observation"][0])
    actions = random_actions(4, 2, 2, 6)
    out = play(env, td, actions)
    for t, action in enumerate(actions[:, 0].flatten(0, 1)[:7]):
        other = plain.step(other.set("action", action[None]))["next"]
        if t % 2 == 1:
            assert torch.equal(out[keys.STATE][0, t // 2], other["observation"][0])
    # Seven steps in chunks of two: the eighth is not executed.
    assert torch.equal(out[keys.STATE][0, 3], other["observation"][0])
    assert out["truncated"].squeeze(-1).tolist() == [[False, False, False, True]] * 2


@pytest.mark.slow
@pytest.mark.usefixtures("rendering")
@pytest.mark.thorough
def test_torchrls_wrapper_for_libero_has_rlcos_entries() -> None:
    env = from_vla(partial(libero_lift, horizon=5), chunk=4)
    check_env_specs(env)
    out = play(env, env.reset(), torch.zeros(2, 1, 4, 7))
    assert out[keys.STATE].shape == (1, 2, 9)
    assert out[keys.IMAGE].shape == (1, 2, 3, 32, 32)
    assert out[keys.IMAGE].dtype == torch.uint8
    assert out["truncated"].flatten().tolist() == [False, True]
    assert out["success"].flatten().tolist() == [False, False]
    assert list(out[:, 0][keys.INSTRUCTION]) == ["lift the cube"]


# -- What is refused --------------------------------------------------------------


def pendulum() -> EnvBase:
    return GymEnv("Pendulum-v1")


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (lambda: SerialEnv(2, pendulum), {}, "SerialEnv of .* give what builds one"),
        (
            lambda: ToyVLAEnv(batch_size=[2]),
            {"num_envs": 3, "horizon": 5},
            r"ToyVLAEnv of batch size \[2\] cannot be copied 3 times",
        ),
        (pendulum, {"state": ["agent_pos"]}, "has no 'agent_pos'; it has observation"),
        (pendulum, {"success": "success"}, "has no 'success'; it has observation"),
        (pendulum, {"chunk": 0}, "chunk=0 is not allowed"),
        (pendulum, {"num_envs": 0}, "num_envs=0 is not allowed"),
        (pendulum, {"horizon": 0}, "horizon=0 is not allowed"),
        (pendulum, {"instructions": []}, r"instructions=\(\) is not allowed"),
        (
            lambda: GymEnv("CartPole-v1"),
            {},
            "actions are OneHot; rlco needs numbers with finite bounds",
        ),
        (
            ToyVLAEnv,
            {"state": [keys.STATE]},
            "truncates no episode; give it a horizon=",
        ),
    ],
)
def test_what_has_no_place_in_rlcos_keys_is_refused(
    make: Any, options: dict[str, Any], message: str
) -> None:
    given = {"state": ["observation"], "success": partial(near, 0.0), **options}
    with pytest.raises(RlcoError, match=message) as caught:
        canonical(make, **given)
    assert str(caught.value).endswith(".")


def test_a_chunk_of_another_length_is_refused() -> None:
    env = from_gymnasium(Counter, chunk=4)
    td = env.reset().set("action", torch.zeros(1, 3, 1))
    with pytest.raises(RlcoError, match="chunk has 3 steps, the environment's 4"):
        env.step(td)


def test_a_success_function_of_another_shape_is_refused() -> None:
    with pytest.raises(RlcoError, match=r"return torch.bool \(\)"):
        from_gymnasium(Counter, success=lambda td: td[keys.STATE] > 0).reset()


def test_a_dictionary_without_agent_pos_needs_state() -> None:
    def make() -> Any:
        return gymnasium.wrappers.TransformObservation(
            Counter(),
            lambda seen: {"a": seen[:1], "b": seen[1:]},
            gymnasium.spaces.Dict(
                {k: gymnasium.spaces.Box(-9, 9, (1,), np.float64) for k in "ab"}
            ),
        )

    with pytest.raises(
        RlcoError, match=r"\['a', 'b'\] have no 'agent_pos'; give state="
    ):
        from_gymnasium(make)
    env = from_gymnasium(make, state=["b", "a"])
    # In the order that was given.
    assert env.reset()[keys.STATE].tolist() == [[5.0, 0.0]]


def test_an_option_that_would_be_lost_is_refused() -> None:
    with pytest.raises(RlcoError, match="num_env= would go to "):
        from_gymnasium(Counter, num_env=8)
