"""Both stages on a LeRobot checkpoint: load, train, save; docs/vla.md explains."""

from dataclasses import asdict
from functools import partial

import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.collectors import RolloutCollector, check_signal
from rlco.data import load_demos
from rlco.envs import make_env
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.physics.tasks.make_task import make_task
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.export import save_lerobot
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.prefix_critic import PrefixCritic, add_next_summaries
from rlco.training import MasterWeightAdamW


def imitate(source, sim, real, target, task="push_cube", alpha=0.5, updates=1000):
    """Return the folder of a checkpoint that has imitated both kinds of data."""
    checkpoint = load_lerobot(source, action_size=7)
    texts = make_task(task).instructions
    policy = LeRobotPolicy(checkpoint, instructions=texts, trained="full")
    load = partial(load_demos, chunk=policy.chunk, instructions=texts)
    sides = {"sim": load(sim), "real": load(real)}
    losses = [ImitationLoss(policy, functional=False) for _ in sides]
    loss = CoTrainingLoss(*losses, sim_coeff=alpha, real_coeff=1 - alpha)
    preset = asdict(checkpoint.config.get_optimizer_preset())
    del preset["grad_clip_norm"]
    optimizer = MasterWeightAdamW(loss.parameters(), **preset)
    for _ in range(updates):
        rows = {root: side.sample(32) for root, side in sides.items()}
        out = loss(TensorDict(rows).to(policy.device))
        optimizer.zero_grad()
        (out["loss_bc"] + out["loss_bc_real"]).backward()
        optimizer.step()
    return save_lerobot(checkpoint, target, step=updates, data=real)


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
    slow = {"params": policy.policy.parameters(), "lr": 4e-6}
    fast = {"params": [*critic.parameters(), *policy.noise.parameters()]}
    optimizer = MasterWeightAdamW([slow, fast], lr=2e-4)
    summaries = partial(add_next_summaries, summary=policy.new_summary)
    collector = RolloutCollector(env, policy, critic, prepare=summaries)
    check_signal(collector.collect(0))  # no success at all: it says so and stops
    for iteration in range(1, iterations + 1):
        rollout = collector.collect(iteration).reshape(-1)
        rollout["vla_action", "log_probs"] = log_probs(policy, rollout, rows=40)
        for sim in rollout[torch.randperm(len(rollout))].split(40):
            batch = TensorDict({"sim": sim, "real": real.sample(16)})
            out = loss(batch.to(policy.device))
            optimizer.zero_grad()
            sum(v for k, v in out.items() if k.startswith("loss_")).backward()
            optimizer.step()
    return save_lerobot(checkpoint, target, step=iterations, data=demos)
