"""A robot that rlco has no task for: demonstrations, and Stage II in a loop of its own.

The arm is Gymnasium's Reacher. The "robot" is one whose motors have half the torque.
"""

from __future__ import annotations

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from rlco.data import DemoWriter, load_demos
from rlco.envs import check_action_units, from_gymnasium
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.policies import GaussianPolicy, ValueNetwork

LINKS = (0.1, 0.11)  # [m]
STATE = [
    "cos.0", "cos.1", "sin.0", "sin.1", "target.x", "target.y",
    "velocity.0", "velocity.1", "error.x", "error.y",
]  # fmt: skip
EPISODE = 50  # control steps


def simulator() -> gymnasium.Env:
    """Return the simulated arm."""
    return gymnasium.make("Reacher-v5")


def robot() -> gymnasium.Env:
    """Return the arm that plays the robot's part."""
    weak = simulator()
    same = weak.action_space
    return gymnasium.wrappers.TransformAction(weak, lambda a: 0.5 * a, same)


def solved(td: TensorDict) -> torch.Tensor:
    """Return whether the finger is within 2 cm of the target."""
    return td["observation", "state"][..., -2:].norm(dim=-1) < 0.02


def teleoperate(state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return torques towards the target: what a person would do by hand."""
    angles = np.cumsum(np.arctan2(state[2:4], state[:2]))
    ends = [
        length * np.array([-np.sin(a), np.cos(a)])
        for length, a in zip(LINKS, angles, strict=True)
    ]
    jacobian = np.stack([ends[0] + ends[1], ends[1]], axis=1)
    damped = jacobian.T @ jacobian + 1e-3 * np.eye(2)
    turn = np.linalg.solve(damped, jacobian.T @ -state[8:10])
    return np.clip(turn - 0.1 * state[6:8], -1.0, 1.0)


def record(folder: str, arm: gymnasium.Env, *, episodes: int, seed: int) -> None:
    """Record demonstrations as a LeRobot data set."""
    with DemoWriter(
        folder, fps=50, state_names=STATE, action_names=["0", "1"]
    ) as writer:
        for episode in range(episodes):
            state, _ = arm.reset(seed=seed + episode)
            for _ in range(EPISODE):
                action = teleoperate(state)
                writer.add_frame(state=state, action=action, task="reach")
                state = arm.step(action)[0]
            writer.save_episode()


def worlds(make, *, num_envs: int, chunk: int) -> EnvBase:
    """Return environments whose actions are in the demonstrations' own units."""
    return from_gymnasium(
        make, success=solved, num_envs=num_envs, chunk=chunk, scale_actions=False
    )


def success_rate(policy: GaussianPolicy, make, *, episodes: int = 64) -> float:
    """Return the share of episodes that are solved at their end, without exploring."""
    env = worlds(make, num_envs=episodes, chunk=policy.chunk)
    env.set_seed(1000)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(-(-EPISODE // policy.chunk), policy)
    return float(rollout["next", "success"][:, -1].float().mean())


def co_train(
    policy: GaussianPolicy,
    demos: str,
    *,
    real_coeff: float,
    iterations: int,
    num_envs: int = 32,
    seed: int = 0,
) -> None:
    """Reinforce in the simulator, anchored to the robot's demonstrations."""
    torch.manual_seed(seed)
    env = worlds(simulator, num_envs=num_envs, chunk=policy.chunk)
    env.set_seed(seed)
    check_action_units(policy, env)
    critic = ValueNetwork(len(STATE))
    # What both read they normalise alike.
    critic.encoder.load_state_dict(policy.encoder.state_dict(), strict=False)
    real = load_demos(demos, chunk=policy.chunk)
    ppo = ClipPPOLoss(policy, critic, entropy_bonus=False)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy), real_coeff=real_coeff)
    groups = [(policy.parameters(), 2e-4), (critic.parameters(), 1e-3)]
    optimizer = torch.optim.Adam([{"params": p, "lr": lr} for p, lr in groups])
    gae = GAE(gamma=0.9, lmbda=0.95, value_network=critic, average_gae=True)
    decisions = num_envs * -(-EPISODE // policy.chunk)
    collector = Collector(
        env,
        policy,
        frames_per_batch=decisions,
        total_frames=iterations * decisions,
        auto_register_policy_transforms=False,
    )
    for rollout in collector:  # whole episodes, [environments, decisions]
        with torch.no_grad():
            gae(rollout)
        rows = rollout.reshape(-1)
        rows["vla_action", "log_probs"] = log_probs(policy, rows)
        for _ in range(4):
            for sim in rows[torch.randperm(len(rows))].split(128):
                out = loss(TensorDict({"sim": sim, "real": real.sample(128)}))
                optimizer.zero_grad()
                sum(v for k, v in out.items() if k.startswith("loss_")).backward()
                torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
                optimizer.step()
    collector.shutdown()
