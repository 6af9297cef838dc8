"""Other TorchRL environments under rlco's keys, by transforms.

What comes out has what `rlco.envs.make_env` gives: a batch [N], actions [N, H, A] in
[-1, 1] (or in the environment's own units), the reward summed over a decision's
executed steps, and the entries of `rlco.keys`. What learns or evaluates in one
environment does so in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torchrl.data import Bounded, TensorSpec, Unbounded
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.batched_envs import BatchedEnvBase
from torchrl.envs.transforms import (
    BatchSizeTransform,
    CatTensors,
    Compose,
    DoubleToFloat,
    PermuteTransform,
    RenameTransform,
    StepCounter,
    Transform,
)

from rlco import keys
from rlco.envs.transforms import (
    ActionChunk,
    Instruction,
    ScaledActions,
    Success,
    SuccessFunction,
    UnitRange,
)
from rlco.errors import RlcoError

Key = str | tuple[str, ...]


def canonical(
    make: Callable[[], EnvBase],
    *,
    state: Sequence[Key],
    success: Key | SuccessFunction,
    instructions: Sequence[str] = ("",),
    environment_state: Sequence[Key] = (),
    image: Key | None = None,
    channels_last: bool = False,
    scale_actions: bool = True,
    horizon: int | None = None,
    num_envs: int = 1,
    chunk: int = 1,
) -> EnvBase:
    """Return worlds of any TorchRL environment, with the entries of `rlco.keys`.

    What comes out has the attribute ``scales_actions``: whether [-1, 1] is mapped to
    another range. A policy's units are checked against it by `check_action_units`.

    Args:
        make: Builds one environment with bounded actions: of batch size [] or [1], or
            [N] where it steps a batch by itself, honouring ``_step``.
        state: Entries that together are the robot's state, in this order.
        success: The entry that says whether a state is solved, bool [1], or a
            function of the observations under their canonical keys.
        instructions: Every instruction there is; the one in use is
            ``language_instruction`` or ``instruction_id`` of the environment, else
            the first.
        environment_state: Entries that together are the environment's state.
        image: The entry that holds camera frames, uint8.
        channels_last: Whether frames are [height, width, C] rather than CHW.
        scale_actions: True: actions are in [-1, 1], which is mapped to the bounds of
            the environment's actions. False: they are in the environment's own units
            (joint angles in degrees, say), as a policy with ``action_limit=None``
            gives them; they need no bounds then, and none are enforced.
        horizon: Control steps after which an episode is truncated.
        num_envs: N, how many worlds are stepped one after the other.
        chunk: H, control steps a decision; a done ends the chunk.

    Raises:
        RlcoError: If actions have no bounds to be scaled to, an entry is missing, a
            number is out of range, or episodes would never be truncated. In a step, if
            actions that are scaled lie ten times beyond [-1, 1].

    Example:
        >>> from torchrl.envs import GymEnv
        >>> env = canonical(
        ...     lambda: GymEnv("Pendulum-v1"),
        ...     state=["observation"],
        ...     success=lambda td: td["observation", "state"][..., 0] > 0.95,
        ...     num_envs=2,
        ...     chunk=4,
        ... )
        >>> rollout = env.rollout(3)
        >>> rollout["action"].shape, rollout["next", "reward"].shape
        (torch.Size([2, 3, 4, 1]), torch.Size([2, 3, 1]))
    """
    numbers = {"horizon": horizon, "num_envs": num_envs, "chunk": chunk}
    for name, value in numbers.items():
        if value is not None and value < 1:
            raise RlcoError(f"{name}={value} is not allowed; give 1 or more.")
    wanted = [*state, *environment_state, *([image] if image is not None else [])]
    wanted += [] if callable(success) else [success]
    first = make()
    _check(first, wanted, horizon, num_envs)
    _check_actions(first.action_spec, scale_actions)
    scales = scale_actions and not _is_unit(first.action_spec)
    looks = _unit_range(first.action_spec) if scales else None

    def transformed(env: EnvBase) -> EnvBase:
        parts = _renaming(state, environment_state, image, channels_last, success)
        parts.append(Instruction(instructions))
        if looks is not None:
            parts.append(ScaledActions(looks))
        if horizon is not None:
            parts.append(StepCounter(max_steps=horizon))
        return TransformedEnv(
            env, Compose(*parts, ActionChunk(chunk)), auto_unwrap=False
        )

    if first.batch_size.numel() > 1:
        batched = transformed(first)
        batched.scales_actions = scales
        return batched
    built = [first]

    # Chunks are executed by each world alone: one may end within its chunk.
    def single() -> EnvBase:
        # Without a device, specs would say "cpu" and texts would not.
        env = (built.pop() if built else make()).to("cpu")
        if len(env.batch_size) == 1:
            squeeze = BatchSizeTransform(reshape_fn=lambda td: td[0])
            # Not merged with the transforms that follow: they see the batch size [].
            env = TransformedEnv(env, squeeze, auto_unwrap=False)
        return transformed(env)

    worlds = SerialEnv(num_envs, single, device="cpu")
    worlds.scales_actions = scales
    return worlds


def _renaming(
    state: Sequence[Key],
    environment_state: Sequence[Key],
    image: Key | None,
    channels_last: bool,
    success: Key | SuccessFunction,
) -> list[Transform]:
    """Return what brings observations to float32 and to rlco's keys."""
    parts: list[Transform] = [DoubleToFloat()]
    renames: dict[Key, Key] = {}
    for name, sources in (("state", state), ("environment_state", environment_state)):
        if sources:
            # By way of the root: TorchRL may use "observation" for one tensor.
            joined = CatTensors(list(sources), f"_{name}", sort=False, del_keys=True)
            parts.append(joined)
            renames[f"_{name}"] = (keys.OBSERVATION, name)
    if image is not None:
        if channels_last:
            parts.append(PermuteTransform((-1, -3, -2), in_keys=[image]))
        renames[image] = keys.IMAGE
    if not callable(success):
        renames[success] = keys.SUCCESS
    renames = {source: key for source, key in renames.items() if source != key}
    parts.append(RenameTransform(list(renames), list(renames.values())))
    if callable(success):
        parts.append(Success(success))
    return parts


def _check(env: EnvBase, wanted: list[Key], horizon: int | None, num_envs: int) -> None:
    size = list(env.batch_size)
    if (
        isinstance(env, BatchedEnvBase)
        or len(size) > 1
        or (size > [1] and num_envs > 1)
    ):
        raise RlcoError(
            f"{type(env).__name__} of batch size {size} cannot be copied {num_envs} "
            "times; give what builds one environment, and num_envs=."
        )
    held = list(env.observation_spec.keys(True, True))
    missing = [key for key in wanted if key not in held]
    if missing:
        raise RlcoError(
            f"the environment has no {missing[0]!r}; it has {', '.join(map(str, held))}"
            "."
        )
    if horizon is None and keys.TRUNCATED not in env.done_keys:
        raise RlcoError("the environment truncates no episode; give it a horizon=.")


def _check_actions(spec: TensorSpec, scale_actions: bool) -> None:
    kind = type(spec).__name__
    if not isinstance(spec, Bounded | Unbounded) or not spec.dtype.is_floating_point:
        raise RlcoError(
            f"the environment's actions are {kind}; rlco needs numbers with finite "
            "bounds."
        )
    bounded = isinstance(spec, Bounded) and bool(
        torch.isfinite(spec.low).all() and torch.isfinite(spec.high).all()
    )
    if scale_actions and not bounded:
        raise RlcoError(
            f"the environment's actions are {kind} without finite bounds, to which "
            "[-1, 1] could be scaled; give the environment bounds, or "
            "scale_actions=False for actions in its own units."
        )


def _is_unit(spec: TensorSpec) -> bool:
    """Return whether actions lie in [-1, 1] by themselves."""
    return isinstance(spec, Bounded) and bool(
        (spec.low == -1).all() and (spec.high == 1).all()
    )


def _unit_range(spec: Bounded) -> UnitRange:
    return UnitRange(float(spec.low.min()), float(spec.high.max()))


def from_vla(
    make: Callable[[], EnvBase],
    *,
    success: SuccessFunction | None = None,
    instructions: Sequence[str] | None = None,
    horizon: int | None = None,
    num_envs: int = 1,
    chunk: int = 1,
) -> EnvBase:
    """Return worlds of an environment of TorchRL's VLA schema under rlco's keys.

    ``ToyVLAEnv``, ``LiberoEnv`` and ``LiberoWrapper`` have that schema. It holds
    state, frame and text already; the text's index and chunks are added.

    Args:
        make: Builds one environment.
        success: A function of the observations; by default the entry ``success``.
        instructions: Every instruction there is; by default the one of the specs.
        horizon: Control steps after which an episode is truncated.
        num_envs: N, how many worlds are stepped one after the other.
        chunk: H, control steps a decision.

    Raises:
        RlcoError: If there is no ``success``, or as `canonical` does.

    Example:
        >>> from torchrl.envs.custom import ToyVLAEnv
        >>> toy = ToyVLAEnv(2, 4, success_steps=2, batch_size=[3])
        >>> env = from_vla(lambda: toy, horizon=8, chunk=2)
        >>> env.reset()["instruction_id"]
        tensor([0, 0, 0])
    """
    first = make()
    spec = first.observation_spec
    if success is None and keys.SUCCESS not in list(spec.keys()):
        raise RlcoError(
            "the environment does not say when it is solved; give success=, a "
            "function of its observations (ToyVLAEnv says it with success_steps=)."
        )
    if instructions is None:
        instructions = [spec[keys.INSTRUCTION].example_data]
    built = [first]
    return canonical(
        lambda: built.pop() if built else make(),
        state=[keys.STATE],
        success=success or keys.SUCCESS,
        instructions=instructions,
        image=keys.IMAGE if keys.IMAGE in spec.keys(True, True) else None,
        horizon=horizon,
        num_envs=num_envs,
        chunk=chunk,
    )


def from_mujoco(
    make: Callable[[], EnvBase],
    *,
    success: SuccessFunction,
    instruction: str = "",
    num_envs: int = 1,
    chunk: int = 1,
) -> EnvBase:
    """Return worlds of one of TorchRL's own MuJoCo environments under rlco's keys.

    Args:
        make: Builds one, ``lambda: Walker2dEnv(backend="mujoco")`` for instance; its
            ``max_episode_steps`` is the horizon.
        success: A function of the observations: these environments know none.
        instruction: What the task is called in words.
        num_envs: N, how many worlds are stepped one after the other.
        chunk: H, control steps a decision.

    Raises:
        RlcoError: As `canonical` does.

    Example:
        >>> from torchrl.envs.custom.mujoco import Walker2dEnv
        >>> env = from_mujoco(
        ...     lambda: Walker2dEnv(backend="mujoco"),
        ...     success=lambda td: td["observation", "state"][..., 0] > 1.0,
        ...     num_envs=2,
        ... )
        >>> env.reset()["observation", "state"].shape
        torch.Size([2, 17])
    """
    return canonical(
        make,
        state=["observation"],
        success=success,
        instructions=[instruction],
        num_envs=num_envs,
        chunk=chunk,
    )
