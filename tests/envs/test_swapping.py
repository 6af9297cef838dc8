"""The same policy and the same loop in every environment that can be had here."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import torch
from other_envs import libero_lift
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import EnvBase, ExcludeTransform, TransformedEnv
from torchrl.envs.custom import ToyVLAEnv
from torchrl.envs.custom.mujoco import Walker2dEnv
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from rlco import keys
from rlco.data import SimRealReplayBuffer
from rlco.envs import from_gymnasium, from_mujoco, from_vla, make_env
from rlco.errors import RenderingError
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.physics.rendering.camera import check_rendering
from rlco.policies import GaussianPolicy, ValueNetwork

pytestmark = pytest.mark.slow

CHUNK, DECISIONS = 2, 4


def beyond(value: float, td: TensorDictBase) -> torch.Tensor:
    return td[keys.STATE][..., 0] > value


def libero() -> EnvBase:
    try:
        check_rendering()
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")
    return from_vla(partial(libero_lift, horizon=6), chunk=CHUNK)


walker = partial(Walker2dEnv, backend="mujoco", max_episode_steps=6, seed=0)
toy = partial(ToyVLAEnv, 7, 14, success_steps=2, batch_size=[2], seed=0)
own: dict[str, Any] = {"num_envs": 2, "chunk": CHUNK, "horizon": 6}
ENVIRONMENTS: dict[str, Callable[[], EnvBase]] = {
    "native": partial(make_env, "push_cube", **own),
    "robosuite": partial(make_env, "push_cube", backend="robosuite", **own),
    "gymnasium, rlco's": partial(from_gymnasium, "rlco/PushCube-v0", **own),
    "gymnasium, MuJoCo": partial(
        from_gymnasium, "Reacher-v5", success=partial(beyond, 0.9), **own
    ),
    "gymnasium, Pendulum": partial(
        from_gymnasium, "Pendulum-v1", success=partial(beyond, 0.9), **own
    ),
    "torchrl, MuJoCo": partial(
        from_mujoco, walker, success=partial(beyond, 1.2), num_envs=2, chunk=CHUNK
    ),
    "torchrl, toy": partial(from_vla, toy, horizon=6, chunk=CHUNK),
    "torchrl, LIBERO's wrapper": libero,
}


def sizes(env: EnvBase) -> dict[str, int]:
    """Return what a policy must know of an environment, read from its specs."""
    spec = env.observation_spec
    has_objects = keys.ENVIRONMENT_STATE in spec.keys(True, True)
    return {
        "state_size": spec[keys.STATE].shape[-1],
        "environment_state_size": spec[keys.ENVIRONMENT_STATE].shape[-1]
        if has_objects
        else 0,
        "num_instructions": spec[keys.INSTRUCTION_ID].space.n,
    }


def collect(env: EnvBase, policy: Any, critic: Any) -> TensorDictBase:
    """Return one rollout with advantages, (N, T)."""
    (count,) = env.batch_size
    collector = Collector(
        TransformedEnv(env, ExcludeTransform(keys.INSTRUCTION)),
        policy,
        frames_per_batch=count * DECISIONS,
        total_frames=count * DECISIONS,
        auto_register_policy_transforms=False,
    )
    (rollout,) = list(collector)
    gae = GAE(gamma=0.97, lmbda=0.95, value_network=critic, average_gae=True)
    with torch.no_grad():
        out: TensorDictBase = gae(rollout)
    return out


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.thorough) if "LIBERO" in name else name
        for name in ENVIRONMENTS
    ],
)
def test_the_same_policy_and_the_same_loop_run(name: str) -> None:
    torch.manual_seed(0)
    env = ENVIRONMENTS[name]()
    size = sizes(env)
    action_size = env.action_spec.shape[-1]
    policy = GaussianPolicy(chunk=CHUNK, action_size=action_size, hidden=(16,), **size)
    critic = ValueNetwork(hidden=(16,), **size)
    rollout = collect(env, policy, critic)
    assert rollout.batch_size == (*env.batch_size, DECISIONS)

    # What the simulator gave, and demonstrations of one and the same action.
    flat = rollout.reshape(-1)
    flat.set(keys.LOG_PROB, log_probs(policy, flat))
    kept = [*policy.in_keys, keys.SAMPLE, keys.LOG_PROB]
    kept += [keys.ADVANTAGE, keys.VALUE_TARGET, keys.STATE_VALUE]
    demos = flat.select(*policy.in_keys)
    demos[keys.CHUNK] = torch.full((len(flat), CHUNK, action_size), 0.5)
    demos[keys.IS_PAD] = torch.zeros(len(flat), CHUNK, dtype=torch.bool)
    sim, real = (ReplayBuffer(storage=LazyTensorStorage(len(flat))) for _ in range(2))
    sim.extend(flat.select(*kept))
    real.extend(demos)
    buffer = SimRealReplayBuffer(sim, real, sim_ratio=0.5, batch_size=2 * len(flat))
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, critic, entropy_bonus=False), ImitationLoss(policy)
    )
    optimizer = torch.optim.Adam([*policy.parameters(), *critic.parameters()], 1e-2)
    terms: list[TensorDictBase] = []
    for _ in range(10):
        (batch,) = list(buffer)
        out = loss(batch)
        terms.append(out.detach())
        optimizer.zero_grad()
        torch.stack(
            [v for k, v in out.items() if k.startswith("loss_")]
        ).sum().backward()
        optimizer.step()
    # The first ratio is 1: nothing is clipped, PPO's loss is -mean(advantage).
    assert terms[0]["clip_fraction"].item() == 0.0
    expected = -flat[keys.ADVANTAGE].mean()
    torch.testing.assert_close(
        terms[0]["loss_objective"], expected, atol=1e-4, rtol=1e-4
    )
    # Ten updates later the policy's two terms, weighted as they are, have fallen.
    first, last = (
        t["loss_objective"] + t["loss_bc_real"] for t in (terms[0], terms[-1])
    )
    assert last < first - 0.005
