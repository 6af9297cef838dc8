"""Demonstrations of one of robosuite's own tasks, which has no expert."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict import TensorDictBase

from rlco import keys
from rlco.data import DemoWriter
from rlco.envs import make_env

LIFT = "robosuite:Lift"
STEPS = 24


def write_lift(folder: Path) -> Path:
    """Record two episodes in which the tool goes towards the cube: no expert's."""
    env = make_env(LIFT, num_envs=2, seed=3, threads=1)
    names = list(env.task.environment_state_names)
    away = names.index("gripper_to_cube_pos.0")

    def reach(td: TensorDictBase) -> TensorDictBase:
        action = torch.zeros(2, 1, 7)
        action[..., :3] = 5.0 * td[keys.ENVIRONMENT_STATE][:, None, away : away + 3]
        return td.set(keys.ACTION, action.clamp(-1, 1))

    rollout = env.rollout(STEPS, reach)
    writer = DemoWriter(
        folder,
        fps=env.task.control_frequency,
        state_names=env.task.state_names,
        action_names=env.task.action_names,
        environment_state_names=names,
    )
    with writer:
        for episode in rollout:
            for row in episode:
                writer.add_frame(
                    state=row[keys.STATE].numpy(),
                    action=row[keys.ACTION][0].numpy(),
                    task=env.task.instructions[0],
                    environment_state=row[keys.ENVIRONMENT_STATE].numpy(),
                )
            writer.save_episode()
    return folder
