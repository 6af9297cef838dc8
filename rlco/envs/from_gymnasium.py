"""Gymnasium's environments under rlco's keys."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from tensordict import TensorDictBase
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, GymWrapper
from torchrl.envs.gym_like import BaseInfoDictReader

from rlco import keys
from rlco.envs.canonical import Key, canonical
from rlco.envs.transforms import SuccessFunction
from rlco.errors import RlcoError

#: Under which names Gymnasium's environments say in `info` that they are solved.
SUCCESS_NAMES = ("is_success", "success")


def from_gymnasium(
    env: str | Callable[[], gymnasium.Env[Any, Any]],
    *,
    success: SuccessFunction | None = None,
    instructions: Sequence[str] | None = None,
    state: Sequence[Key] | None = None,
    scale_actions: bool = True,
    horizon: int | None = None,
    num_envs: int = 1,
    chunk: int = 1,
    **options: Any,
) -> EnvBase:
    """Return worlds of a Gymnasium environment under rlco's keys.

    Observations are one vector, or a dictionary with LeRobot's names: ``agent_pos``
    becomes the state, ``environment_state`` the environment's, ``pixels`` the image.

    Args:
        env: The id of an environment, or what builds one.
        success: A function of the observations; by default ``is_success`` or
            ``success`` of ``info``.
        instructions: Every instruction there is; by default those that the
            environment lists as `instructions`, or the one in `task_description`, or
            an empty one. ``info["instruction_id"]`` picks.
        state: Entries of a dictionary that together are the state, where it has no
            ``agent_pos``.
        scale_actions: True: actions are in [-1, 1], which is mapped to the
            environment's Box. False: they are in the environment's own units, for a
            policy that acts in them (``action_limit=None``, what ``task=null`` trains):
            an action of 2.9 then is 2.9 degrees where the Box is in degrees.
        horizon: Control steps after which an episode is truncated, beside what the
            environment does itself.
        num_envs: N, how many worlds are stepped one after the other.
        chunk: H, control steps a decision.
        options: Go to ``gymnasium.make`` with an id.

    Raises:
        RlcoError: If the environment does not say when it is solved, if its
            observations have no place in rlco's keys, if there are options without an
            id, or as `canonical` does.

    Example:
        >>> import rlco.envs
        >>> env = rlco.envs.from_gymnasium("rlco/PushCube-v0", num_envs=2, chunk=4)
        >>> env.rollout(3)["observation", "environment_state"].shape
        torch.Size([2, 3, 12])
    """
    if options and not isinstance(env, str):
        raise RlcoError(
            f"{', '.join(options)}= would go to gymnasium.make, which is not called "
            "for a function that builds the environment; give it there, or correct "
            "its name."
        )

    def build() -> gymnasium.Env[Any, Any]:
        made: gymnasium.Env[Any, Any]
        made = gymnasium.make(env, **options) if isinstance(env, str) else env()
        return made

    probe = build()
    reader = InfoReader(_info_names(probe, wanted=success is None))
    sources = _sources(probe.observation_space, state)
    texts = instructions or _instructions(probe)
    probe.close()

    def single() -> GymWrapper:
        made = GymWrapper(build())
        made.set_info_dict_reader(reader)
        return made

    return canonical(
        single,
        success=success or keys.SUCCESS,
        instructions=texts,
        horizon=horizon,
        num_envs=num_envs,
        chunk=chunk,
        channels_last=True,
        scale_actions=scale_actions,
        **sources,
    )


class InfoReader(BaseInfoDictReader):
    """Reads success and the instruction's index from ``info``; absent means 0.

    TorchRL's own reader wants NumPy values, and success is mostly a plain bool.

    Args:
        names: rlco's key -> the name in ``info``.
    """

    def __init__(self, names: dict[str, str]) -> None:
        self.names = names
        spec = {
            keys.SUCCESS: Categorical(2, (1,), dtype=torch.bool),
            keys.INSTRUCTION_ID: Unbounded((), dtype=torch.int64),
        }
        self._spec = Composite({key: spec[key] for key in names})

    @property
    def info_spec(self) -> Composite:
        """What is read."""
        return self._spec

    def __call__(
        self, info_dict: dict[str, Any], tensordict: TensorDictBase
    ) -> TensorDictBase:
        """Write what is read into `tensordict`."""
        for key, name in self.names.items():
            spec = self._spec[key]
            value = torch.as_tensor(info_dict.get(name, 0))
            tensordict.set(key, value.to(spec.dtype).reshape(spec.shape))
        return tensordict


def _info_names(env: gymnasium.Env[Any, Any], *, wanted: bool) -> dict[str, str]:
    """Return which entries of ``info`` to read, found by one reset and one step."""
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[-1]
    names = {}
    if keys.INSTRUCTION_ID in info:
        names[keys.INSTRUCTION_ID] = keys.INSTRUCTION_ID
    if wanted:
        found = [name for name in SUCCESS_NAMES if name in info]
        if not found:
            raise RlcoError(
                f"the info of {env} has neither 'is_success' nor 'success' but "
                f"{sorted(info)}; give success=, a function of the observations."
            )
        names[keys.SUCCESS] = found[0]
    return names


def _sources(space: spaces.Space[Any], state: Sequence[Key] | None) -> dict[str, Any]:
    """Return which entries of TorchRL's wrapper are state, environment and image."""
    if isinstance(space, spaces.Box) and len(space.shape) == 1:
        return {"state": [keys.OBSERVATION]}
    if not isinstance(space, spaces.Dict):
        raise RlcoError(
            f"observations in {space} have no place in rlco's keys; wrap the "
            "environment so that they are one vector or a dictionary of them."
        )
    if state is None:
        if "agent_pos" not in space.spaces:
            raise RlcoError(
                f"the observations {sorted(space.spaces)} have no 'agent_pos'; give "
                "state=, the entries that together are the state."
            )
        state = ["agent_pos"]
    sources: dict[str, Any] = {"state": list(state)}
    if "environment_state" in space.spaces:
        sources["environment_state"] = ["environment_state"]
    if "pixels" in space.spaces:
        sources["image"] = "pixels"
    return sources


def _instructions(env: gymnasium.Env[Any, Any]) -> Sequence[str]:
    if env.has_wrapper_attr("instructions"):
        found: Sequence[str] = env.get_wrapper_attr("instructions")
        return found
    if env.has_wrapper_attr("task_description"):
        return [str(env.get_wrapper_attr("task_description"))]
    # What LeRobot uses where an environment names no task.
    return [""]
