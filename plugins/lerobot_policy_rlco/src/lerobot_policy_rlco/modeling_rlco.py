"""One of rlco's policies behind LeRobot's interface."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from lerobot_policy_rlco.configuration_rlco import RlcoConfig
from rlco import keys
from rlco.data.resize import resized
from rlco.errors import ConfigError, DataError, suggest
from rlco.losses import ImitationLoss
from rlco.policies import check_observations, make_policy


class RlcoPolicy(PreTrainedPolicy):
    """A policy of rlco, acting without noise.

    Args:
        config: its kind, arguments and instructions.
    """

    config_class = RlcoConfig
    name = "rlco"

    def __init__(self, config: RlcoConfig, **kwargs: Any) -> None:
        del kwargs  # What LeRobot's factory passes to every policy.
        super().__init__(config)
        self.config = config
        self.actor = make_policy(config.kind, **json.loads(config.arguments))
        check_observations(self.actor)
        self.reset()

    def get_optim_params(self) -> Any:
        """Return what is trained."""
        return self.parameters()

    def reset(self) -> None:
        """Forget the rest of the chunk."""
        self._queue: deque[torch.Tensor] = deque()

    def _rows(self, batch: dict[str, Any]) -> TensorDict:
        """Return LeRobot's batch under rlco's keys.

        Raises:
            DataError: it lacks a feature that the policy reads, or its task is new.
        """
        # In the order of the policy's cameras, as `export_policy` writes them.
        seen = filter(keys.is_image, self.actor.in_keys)
        names: dict[Any, str] = {
            keys.STATE: OBS_STATE,
            keys.ENVIRONMENT_STATE: OBS_ENV_STATE,
            **dict(zip(seen, self.config.image_features, strict=True)),
        }
        read = {key: names[key] for key in self.actor.in_keys if key in names}
        if missing := [name for name in read.values() if name not in batch]:
            held = sorted(name for name in batch if name.startswith("observation."))
            raise DataError(
                f"the policy reads {' and '.join(missing)}, which the robot or the "
                f"environment does not give (it gives {', '.join(held) or 'nothing'}); "
                "add it there, or train a policy that does not read it."
            )
        state = batch[OBS_STATE]
        rows = TensorDict(batch_size=[len(state)])
        for key, name in read.items():
            image = keys.is_image(key)
            rows.set(key, self._pictures(batch, name) if image else batch[name])
        if keys.INSTRUCTION_ID in self.actor.in_keys:
            ids = [self._instruction(text) for text in batch["task"]]
            rows.set(keys.INSTRUCTION_ID, torch.tensor(ids, device=state.device))
        if ACTION in batch:
            rows.set(keys.CHUNK, batch[ACTION])
            if "action_is_pad" in batch:
                rows.set(keys.IS_PAD, batch["action_is_pad"])
        return rows

    def _pictures(self, batch: dict[str, Any], name: str) -> torch.Tensor:
        """Return a camera's frames, uint8, cut and made smaller as in training.

        Raises:
            DataError: they are smaller than those that the policy was trained with.
        """
        _, height, width = self.config.image_features[name].shape
        frames = batch[name]
        if frames.shape[-2] < height or frames.shape[-1] < width:
            raise DataError(
                f"{name} gives frames of {frames.shape[-2]} x {frames.shape[-1]}, "
                f"smaller than the {height} x {width} that the policy was trained "
                "with; let the camera give larger ones."
            )
        # LeRobot's frames are fractions of full brightness.
        return resized((frames * 255).round().to(torch.uint8), (height, width))

    def _instruction(self, text: str) -> int:
        known = self.config.instructions
        if text not in known:
            raise DataError(
                f"the policy was not trained on the task {text!r}"
                f"{suggest(text, known)}; it knows: {', '.join(map(repr, known))}."
            )
        return known.index(text)

    @torch.no_grad()
    def predict_action_chunk(
        self, batch: dict[str, Any], **kwargs: Any
    ) -> torch.Tensor:
        """Return raw actions (B, H, A)."""
        del kwargs
        self.eval()
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            chunk: torch.Tensor = self.actor(self._rows(batch))[keys.ACTION]
        return chunk

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **kwargs: Any) -> torch.Tensor:
        """Return the next action (B, A) of the present chunk, or of a new one."""
        if not self._queue:
            chunk = self.predict_action_chunk(batch, **kwargs)
            self._queue.extend(chunk[:, : self.config.n_action_steps].unbind(1))
        return self._queue.popleft()

    def forward(
        self, batch: dict[str, Any], reduction: str = "mean"
    ) -> tuple[torch.Tensor, dict[str, float]]:
        """Return the imitation loss, padding left out, for ``lerobot-train``.

        Args:
            batch: LeRobot's, of B frames with the actions that follow them.
            reduction: "mean" over all steps, or "none": (B,), each frame's own mean,
                which LeRobot's sample weights multiply.

        Raises:
            ConfigError: another reduction.
        """
        rows = self._rows(batch)
        if reduction == "none":
            error = self.actor.imitation_loss(rows)
            counted = torch.ones_like(error, dtype=torch.bool)
            if keys.IS_PAD in rows:
                counted = ~rows[keys.IS_PAD]
            total = torch.where(counted, error, 0.0).sum(1)
            loss = total / counted.sum(1).clamp_min(1)
        elif reduction == "mean":
            loss = ImitationLoss(self.actor, functional=False)(rows)["loss_bc"]
        else:
            raise ConfigError([f"reduction={reduction!r} is neither 'mean' nor 'none'"])
        return loss, {"loss_bc": float(loss.detach().mean())}
