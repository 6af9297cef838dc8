"""TorchRL's own PPOTrainer trains with CoTrainingLoss and one hook."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import (
    LazyTensorStorage,
    SamplerWithoutReplacement,
    TensorDictReplayBuffer,
)
from torchrl.modules import (
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
    ValueOperator,
)
from torchrl.objectives import BCLoss, ClipPPOLoss
from torchrl.testing.mocking_classes import ContinuousActionVecMockEnv
from torchrl.trainers.algorithms.ppo import PPOTrainer

from rlco.losses import CoTrainingLoss


def test_ppo_trainer_optimises_both_terms() -> None:
    env = ContinuousActionVecMockEnv()
    observed = env.observation_spec["observation"].shape[-1]
    acted = env.action_spec.shape[-1]
    module = TensorDictModule(
        nn.Sequential(nn.Linear(observed, 2 * acted), NormalParamExtractor()),
        in_keys=["observation"],
        out_keys=["loc", "scale"],
    )
    actor = ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Linear(observed, 1), in_keys=["observation"])
    # The objective weighs nothing beside the anchor: what is learned is the anchor.
    loss = CoTrainingLoss(
        ClipPPOLoss(actor, critic), BCLoss(actor), sim_coeff=1e-6, real_coeff=1.0
    )
    real = TensorDict({"observation": torch.randn(8, observed)}, [8])
    real["action"] = torch.full((8, acted), 0.5)
    before = float(BCLoss(actor)(real)["loss_bc"].detach())
    trainer = PPOTrainer(
        collector=Collector(env, actor, frames_per_batch=32, total_frames=128),
        total_frames=128,
        frame_skip=1,
        optim_steps_per_batch=1,
        loss_module=loss,
        optimizer=torch.optim.Adam(loss.parameters(), 3e-2),
        replay_buffer=TensorDictReplayBuffer(
            storage=LazyTensorStorage(32),
            sampler=SamplerWithoutReplacement(),
            batch_size=16,
        ),
        num_epochs=4,
        enable_logging=False,
        progress_bar=False,
    )

    def add_real(sim: TensorDictBase) -> TensorDictBase:
        return TensorDict({"sim": sim, "real": real})

    trainer.register_op("process_optim_batch", add_real)
    trainer.train()
    assert float(BCLoss(actor)(real)["loss_bc"].detach()) < before - 0.5
