"""What TorchRL's transforms leave to do between its environments and rlco's keys."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import torch
from tensordict import NonTensorData, NonTensorStack, TensorDictBase
from torchrl.data import (
    Categorical,
    Composite,
    NonTensor,
)
from torchrl.envs.transforms import ActionScaling, MultiAction, Transform

from rlco import keys
from rlco.errors import RlcoError
from rlco.physics.spec.actions import FAR, LIMIT, TOLERANCE

_logger = logging.getLogger(__name__)

#: Observations [*B, ...] -> whether each state is solved, bool [*B] or [*B, 1].
SuccessFunction = Callable[[TensorDictBase], torch.Tensor]


class Instruction(Transform):
    """Writes the instruction as text and as its index, both [*B].

    Whichever of the two the environment gives decides the other; where it gives
    neither, all environments have the first instruction.

    Args:
        instructions: Every instruction there is.

    Raises:
        RlcoError: If there is none, or the environment gives one that is not listed.
    """

    def __init__(self, instructions: Sequence[str]) -> None:
        super().__init__(out_keys=[keys.INSTRUCTION, keys.INSTRUCTION_ID])
        if not instructions:
            raise RlcoError("instructions=() is not allowed; give one or more texts.")
        self.instructions = tuple(instructions)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        ids = next_tensordict.get(keys.INSTRUCTION_ID, None)
        if ids is None:
            ids = self._ids(next_tensordict)
            next_tensordict.set(keys.INSTRUCTION_ID, ids)
        device = next_tensordict.device
        texts = [
            NonTensorData(self.instructions[index], device=device)
            for index in ids.reshape(-1).tolist()
        ]
        text = NonTensorStack(*texts) if next_tensordict.batch_size else texts[0]
        return next_tensordict.set(keys.INSTRUCTION, text)

    def _ids(self, tensordict: TensorDictBase) -> torch.Tensor:
        shape = tensordict.batch_size
        if keys.INSTRUCTION not in list(tensordict.keys()):
            return torch.zeros(shape, dtype=torch.int64)
        # Brackets give plain text: one string, or one an environment.
        given = tensordict[keys.INSTRUCTION]
        found = [given] * shape.numel() if isinstance(given, str) else list(given)
        unknown = sorted(set(found) - set(self.instructions))
        if unknown:
            raise RlcoError(
                f"the environment gives the instruction {unknown[0]!r}, which is not "
                f"among the {len(self.instructions)} given ones; add it."
            )
        ids = [self.instructions.index(text) for text in found]
        return torch.tensor(ids, dtype=torch.int64).reshape(shape)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add text and index."""
        shape, count = observation_spec.shape, len(self.instructions)
        observation_spec[keys.INSTRUCTION] = NonTensor(
            shape, example_data=self.instructions[0]
        )
        observation_spec[keys.INSTRUCTION_ID] = Categorical(
            count, shape, dtype=torch.int64
        )
        return observation_spec


class Success(Transform):
    """Writes `success`, bool [*B, 1], computed from the observations.

    Args:
        function: Observations -> whether each state is solved, bool [*B] or [*B, 1].

    Raises:
        RlcoError: If the function returns another shape or another dtype.
    """

    def __init__(self, function: SuccessFunction) -> None:
        super().__init__(out_keys=[keys.SUCCESS])
        # In a tuple: an nn.Module as an attribute would count as a submodule.
        self._function = (function,)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        solved = self._function[0](next_tensordict)
        shape = next_tensordict.batch_size
        if solved.dtype != torch.bool or solved.shape not in (shape, (*shape, 1)):
            raise RlcoError(
                f"the success function returned {solved.dtype} {tuple(solved.shape)}; "
                f"return torch.bool {tuple(shape)}."
            )
        return next_tensordict.set(keys.SUCCESS, solved.reshape(*shape, 1))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag."""
        shape = (*observation_spec.shape, 1)
        observation_spec[keys.SUCCESS] = Categorical(2, shape, dtype=torch.bool)
        return observation_spec


class UnitRange:
    """Looks at actions that are about to be mapped from [-1, 1] to another range.

    Those beyond [-1, 1] are mapped beyond that range, the first time with a warning.

    Args:
        low: Least number of the environment's own actions, for messages.
        high: The greatest.
    """

    def __init__(self, low: float, high: float) -> None:
        self.reach = f"{low:g} to {high:g}"
        self._silent = False

    def check(self, actions: torch.Tensor) -> None:
        """Check actions (..., A).

        Raises:
            RlcoError: A number is ten times beyond [-1, 1], or more.
        """
        if not bool((actions.abs() > LIMIT + TOLERANCE).any()):
            return
        low, high = float(actions.min()), float(actions.max())
        found = (
            f"actions reach from {low:.4g} to {high:.4g}, but this environment maps "
            f"[-1, 1] to its own range, {self.reach}"
        )
        advice = (
            "build it with scale_actions=False where they are in its own units, as "
            "those of a policy with action_limit=None are"
        )
        if max(-low, high) >= FAR:
            raise RlcoError(f"{found}; {advice}, or scale them to [-1, 1].")
        if not self._silent:
            _logger.warning(
                "%s; %s. Later ones are mapped without a word.", found, advice
            )
        self._silent = True


class ScaledActions(ActionScaling):
    """TorchRL's `ActionScaling`, which maps [-1, 1] to the environment's own range.

    Args:
        looks: Looks at the actions first; one for all worlds, so that it warns once.
    """

    def __init__(self, looks: UnitRange) -> None:
        super().__init__()
        self._looks = looks

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._looks.check(tensordict.get(keys.ACTION))
        return super()._inv_call(tensordict)


class ActionChunk(MultiAction):
    """TorchRL's `MultiAction` with one reward a decision, over chunks of length H.

    `MultiAction` stacks the rewards of the executed steps, one more or less where an
    episode ends within a chunk. Here a decision's reward is their sum, [*B, 1],
    and the specs say how long a chunk is: actions [*B, H, A], each as it was.

    Args:
        chunk: H, control steps a decision.

    Raises:
        RlcoError: If an action chunk has another length.
    """

    def __init__(self, chunk: int) -> None:
        super().__init__(stack_rewards=True)
        self.chunk = chunk

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        length = tensordict.get(keys.ACTION).shape[-2]
        if length != self.chunk:
            raise RlcoError(
                f"the action chunk has {length} steps, the environment's {self.chunk}; "
                "build policy and environment with the same chunk length."
            )
        return super()._inv_call(tensordict)

    def _step(
        self, tensordict: TensorDictBase | None, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        # Also called for episodes that ended within the chunk, which no transform
        # that comes after this one sees: the sum cannot be a transform of its own.
        out = super()._step(tensordict, next_tensordict)
        return out.set(keys.REWARD, out.get(keys.REWARD).sum(dim=-2))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Give chunks their length, which `MultiAction` leaves open."""
        spec = input_spec["full_action_spec", keys.ACTION]
        (*lead, numbers) = spec.shape
        shape = (*lead, self.chunk, numbers)
        chunks = spec.unsqueeze(-2).expand(shape).clone()
        input_spec["full_action_spec", keys.ACTION] = chunks
        return input_spec

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Change nothing: one reward a decision, the last observation."""
        return output_spec
