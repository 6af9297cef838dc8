"""The configuration that LeRobot parses, and the environments that it builds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from rlco.errors import ConfigError
from rlco.physics.effects import load_code
from rlco.physics.spec.actions import ActionRange
from rlco.physics.spec.domain import make_domain
from rlco.physics.tasks.gymnasium_env import TaskEnv
from rlco.physics.tasks.make_task import make_task


@EnvConfig.register_subclass("rlco")
@dataclass
class RlcoEnv(EnvConfig):
    """A task of rlco, see `rlco.physics.tasks.gymnasium_env.TaskEnv`.

    Attributes:
        task: name of the task.
        fps: control steps a second; the tasks' own, for videos.
        domain: ``sim``, ``stand_in``, or the path of a domain's file, such as the gap
            workflow's ``effects.yaml``.
        effects_code: a Python file that registers effects of your own.
        variation: a named variation of the scene.
        camera: last part of the camera's name, ``front`` for
            ``observation.images.front``; None: numbers alone, and the objects' poses
            among them. Of several cameras ``front,wrist``.
        cameras: which of the simulator's cameras these are, in the same order.
        image_size: pixels along each side of a frame.
        renderer: what draws them, ``raster`` or ``opengl``.
        look: how they look, ``sim``, ``stand_in``, ``locked`` or ``random``; None: as
            the domain says.
        horizon: control steps of an episode; the task's own by default.
        terminate_on_success: whether an episode ends where it is solved. LeRobot counts
            it as solved then; otherwise what counts is its end.
    """

    task: str = "push_cube"
    fps: int = 20
    domain: str = "sim"
    effects_code: str | None = None
    variation: str | None = None
    camera: str | None = None
    cameras: str = "agentview"
    image_size: int = 128
    renderer: str = "opengl"
    look: str | None = None
    horizon: int | None = None
    terminate_on_success: bool = False

    def __post_init__(self) -> None:
        load_code(self.effects_code)
        make_domain(self.domain)  # LeRobot loads the policy before the environments

        task = make_task(self.task)

        def numbers(kind: FeatureType, size: int) -> PolicyFeature:
            return PolicyFeature(type=kind, shape=(size,))

        self.features[ACTION] = numbers(FeatureType.ACTION, len(task.action_names))
        self.features["agent_pos"] = numbers(FeatureType.STATE, len(task.state_names))
        self.features_map |= {ACTION: ACTION, "agent_pos": OBS_STATE}
        if self.camera is None:
            names = task.environment_state_names
            self.features["environment_state"] = numbers(FeatureType.ENV, len(names))
            self.features_map["environment_state"] = OBS_ENV_STATE
        shape = (self.image_size, self.image_size, 3)
        for name in self._names():
            self.features[f"pixels/{name}"] = PolicyFeature(FeatureType.VISUAL, shape)
            self.features_map[f"pixels/{name}"] = f"{OBS_IMAGES}.{name}"

    def _names(self) -> dict[str, str]:
        """Return the simulator's camera of each of LeRobot's.

        Raises:
            ConfigError: another number of cameras than of names.
        """
        if self.camera is None:
            return {}
        names, cameras = self.camera.split(","), self.cameras.split(",")
        if len(names) != len(cameras):
            raise ConfigError(
                [
                    f"camera={self.camera} and cameras={self.cameras} are not as many; "
                    "name one of the simulator's cameras for each of LeRobot's"
                ]
            )
        return dict(zip(names, cameras, strict=True))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Return the options of one environment."""
        return {
            "domain": self.domain,
            "effects_code": self.effects_code,
            "variation": self.variation,
            "obs_type": "state" if self.camera is None else "pixels_agent_pos",
            "image_size": (self.image_size, self.image_size),
            "renderer": self.renderer,
            "cameras": tuple(self._names().values()) or ("agentview",),
            "look": self.look,
            "horizon": self.horizon,
            "terminate_on_success": self.terminate_on_success,
            "render_mode": "rgb_array",
        }

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, VectorEnv]]:
        """Return so many copies of the task, as LeRobot nests them."""

        def one() -> gymnasium.Env[Any, Any]:
            return Episode(TaskEnv(self.task, **self.gym_kwargs), self._names())

        mode = AutoresetMode.SAME_STEP
        if use_async_envs and n_envs > 1:
            # What renders does not survive a fork.
            copies: VectorEnv = AsyncVectorEnv(
                [one] * n_envs, autoreset_mode=mode, context="forkserver"
            )
        else:
            copies = SyncVectorEnv([one] * n_envs, autoreset_mode=mode)
        return {self.type: {0: copies}}


class Episode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task whose episodes are judged at their end, and whose cameras have names.

    LeRobot counts an episode as solved if any of its steps was.

    Args:
        env: the task.
        cameras: the simulator's camera of each of LeRobot's; empty without images.
    """

    def __init__(self, env: TaskEnv, cameras: dict[str, str]) -> None:
        super().__init__(env)
        self._cameras = cameras
        self._action_range = ActionRange()
        if cameras:
            parts: dict[str, spaces.Space[Any]] = dict(
                cast(spaces.Dict, env.observation_space)
            )
            pixels: Any = parts["pixels"]
            parts["pixels"] = spaces.Dict(self._by_name(pixels))
            self.observation_space = spaces.Dict(parts)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._named(observation), {**info, "is_success": False}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Execute one control step."""
        self._action_range.check(action)
        given = np.clip(action, -1.0, 1.0)
        observation, reward, terminated, truncated, info = self.env.step(given)
        ended = terminated or truncated
        info["is_success"] = bool(ended and info["is_success"])
        return self._named(observation), float(reward), terminated, truncated, info

    def _named(self, observation: dict[str, Any]) -> dict[str, Any]:
        if not self._cameras:
            return observation
        return {**observation, "pixels": self._by_name(observation["pixels"])}

    def _by_name(self, pixels: Any) -> dict[str, Any]:
        """Return what there is of each camera by LeRobot's names."""
        if len(self._cameras) == 1:
            return dict.fromkeys(self._cameras, pixels)
        return {name: pixels[camera] for name, camera in self._cameras.items()}
