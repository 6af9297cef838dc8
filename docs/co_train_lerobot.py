"""Load a LeRobot checkpoint, co-train it, save it back; docs/vla.md explains."""

from functools import partial

import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.collectors import RolloutCollector
from rlco.data import load_demos
from rlco.envs import make_env
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.physics.task import make_task
from rlco.policies.lerobot_checkpoint import load_lerobot
from rlco.policies.lerobot_export import save_lerobot
from rlco.policies.lerobot_policies import LeRobotPolicy
from rlco.policies.prefix_critic import PrefixCritic, add_next_summaries


def co_train(source, demos, target, task="push_cube", iterations=100, num_envs=64):
    """Return the folder that ``lerobot-eval --policy.path`` runs."""
    checkpoint = load_lerobot(source, action_size=7)
    texts = make_task(task).instructions
    policy = LeRobotPolicy(checkpoint, instructions=texts)
    real = load_demos(demos, chunk=policy.chunk, instructions=texts)
    size = policy.inputs.image_size
    env = make_env(task, num_envs=num_envs, chunk=policy.executed, image_size=size)
    critic = PrefixCritic(policy.model.summary_size).to(policy.device)
    ppo = ClipPPOLoss(policy, critic, functional=False, entropy_bonus=False)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy, functional=False), real_coeff=0.2)
    optimizer = torch.optim.AdamW(loss.parameters(), lr=4e-6)
    summaries = partial(add_next_summaries, prefix=policy.new_prefix)
    collector = RolloutCollector(env, policy, critic, prepare=summaries)
    for iteration in range(iterations):
        rollout = collector.collect(iteration).reshape(-1)
        rollout["vla_action", "log_probs"] = log_probs(policy, rollout, rows=40)
        for sim in rollout[torch.randperm(len(rollout))].split(40):
            batch = TensorDict({"sim": sim, "real": real.sample(16)})
            out = loss(batch.to(policy.device))
            optimizer.zero_grad()
            sum(v for k, v in out.items() if k.startswith("loss_")).backward()
            optimizer.step()
    return save_lerobot(checkpoint, target, step=iterations, data=demos)
