"""The tasks as Gymnasium environments, with LeRobot's names of observations."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rlco.errors import RlcoError, SimulationError, UnknownNameError
from rlco.physics.effects import load_code
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.native.world_checks import check_native
from rlco.physics.rendering.camera import Quality
from rlco.physics.rendering.image_size import check_image_size
from rlco.physics.rendering.renderers import check_renderer
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.actions import ActionRange
from rlco.physics.spec.domain import Domain, GivenDomain, make_domain, with_look
from rlco.physics.spec.looks import GivenLook
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.streams import Stream
from rlco.physics.spec.task import SceneState, Task
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.variations import (
    check_variation_images,
    check_variation_of,
    domain_in,
)
from rlco.physics.tasks.views import Views, check_cameras

ObservationKind = Literal["state", "pixels_agent_pos"]
Observation = dict[str, Any]  # arrays, or a map of cameras to arrays
_ONE = np.zeros(1, np.int64)  # the only world
_logger = logging.getLogger(__name__)
_CHOICES = {
    "backend": ("native", "robosuite"),
    "reward": ("shaped", "sparse"),
    "obs_type": get_args(ObservationKind),
    "render_mode": (None, "rgb_array"),
}


class TaskEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One episode at a time of a task, one control step at a time.

    Observations have the names that LeRobot reads: ``agent_pos`` (S,) is the robot's
    state, ``environment_state`` (E,) the objects as a camera would report them,
    ``pixels`` (height, width, 3) a camera frame, or one of each of several cameras by
    its name. An action has A values in [-1, 1].
    ``info`` contains ``is_success``, whether the task is solved in this very state,
    ``instruction_id`` and ``diverged``. The attribute `task_description` is the
    episode's instruction, and `instructions` lists all there are.

    Episodes are truncated at the horizon. Success does not end them unless
    `terminate_on_success`: a task counts as solved when it is solved at the end.

    An episode whose simulation diverges is truncated there, with reward 0, its last
    valid observation, and ``diverged`` in its ``info``; the next reset starts the next
    one. The first is logged, `divergences` counts them.

    ``reset(seed=s)`` starts the first episode of seed s, and each reset without a seed
    the next one. They equal those of ``make_env(..., num_envs=1, chunk=1, seed=s)``,
    with the same initial states and the same sensor noise. ``options={"episode": k}``
    starts the k-th episode of the seed.

    Args:
        task: A task or its name.
        domain: A domain, its name (``sim`` or ``stand_in``), or the path of its file,
            such as the gap workflow's ``effects.yaml``.
        backend: ``native`` or ``robosuite``. The motion is the same up to rounding,
            which contacts magnify; with ``exact=True`` to the last bit.
        exact: As in `rlco.envs.make_env`.
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        variation: A named variation of the scene, one of the task's.
        obs_type: ``state`` gives ``agent_pos`` and ``environment_state``,
            ``pixels_agent_pos`` gives ``pixels`` and ``agent_pos``.
        image_size: Height and width of observed and of rendered frames [pixels].
        image_quality: Of ``opengl``: ``fast`` or ``robosuite``, see
            `rlco.physics.rendering.camera.Camera`.
        renderer: ``opengl`` or ``raster``, as in `rlco.envs.make_env`.
        cameras: Names of the cameras whose frames are observed; the first is rendered.
        look: How frames look, as in `rlco.envs.make_env`; None: as the domain says.
        terminate_on_success: End an episode, as ``terminated``, when it is solved.
        render_mode: ``rgb_array``, or None.
        effects_code: Python file that registers effects of your own.

    Attributes:
        divergences: Number of simulations that diverged since construction.

    Raises:
        UnknownNameError: If a name is unknown.
        RlcoError: If a number is out of range, options conflict, the domain's file
            cannot be read, or one of its effects cannot be applied.
        RenderingError: If frames are requested but rendering is impossible.

    Example:
        >>> env = TaskEnv("push_cube")
        >>> observation, info = env.reset(seed=1)
        >>> sorted(observation), env.task_description, info["is_success"]
        (['agent_pos', 'environment_state'], 'push the blue cube onto its mark', False)
        >>> observation, reward, terminated, truncated, info = env.step(np.zeros(7))
        >>> terminated, truncated
        (False, False)
    """

    # Gymnasium reads this before there is an instance.
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        task: str | Task,
        *,
        domain: GivenDomain = "sim",
        backend: Literal["native", "robosuite"] = "native",
        exact: bool = False,
        reward: Literal["shaped", "sparse"] = "shaped",
        horizon: int | None = None,
        variation: str | None = None,
        obs_type: ObservationKind = "state",
        image_size: tuple[int, int] = (128, 128),
        image_quality: Quality = "fast",
        renderer: Renderer = "opengl",
        cameras: Sequence[str] = ("agentview",),
        look: GivenLook | None = None,
        terminate_on_success: bool = False,
        render_mode: Literal["rgb_array"] | None = None,
        effects_code: str | Path | None = None,
    ) -> None:
        given = {
            "backend": backend,
            "reward": reward,
            "obs_type": obs_type,
            "render_mode": render_mode,
        }
        _check(given, horizon, image_size)
        check_renderer(renderer, image_quality)
        check_cameras(cameras)
        images = render_mode is not None or obs_type == "pixels_agent_pos"
        for name, value, plain in (
            ("image_quality", image_quality, "fast"),
            ("renderer", renderer, "opengl"),
            ("cameras", tuple(cameras), ("agentview",)),
            ("look", look, None),
        ):
            if value != plain and not images:
                raise RlcoError(
                    f"{name}={value!r} is of no use without images; give "
                    "render_mode='rgb_array' or obs_type='pixels_agent_pos'."
                )
        check_native(backend, threads=None, exact=exact)
        load_code(effects_code)
        self._task = make_task(task)
        check_variation_of(self._task, variation)
        check_variation_images(variation, image_size if images else None)
        self._domain = domain_in(with_look(make_domain(domain), look), variation)
        self.task = self._task.name
        self.instructions = self._task.instructions
        self.task_description = self.instructions[0]
        self.metadata = {
            **type(self).metadata,
            "render_fps": self._task.control_frequency,
        }
        self.render_mode = render_mode
        self._max_episode_steps = horizon or self._task.horizon
        self._reward_kind = reward
        self._variation = variation
        self._obs_type = obs_type
        self._terminate = terminate_on_success
        self.stepper = _stepper(self._task, self._domain, backend, exact, variation)
        self.divergences = 0
        self._action_range = ActionRange()
        self._diverged = False
        self._last_observation: Observation = {}
        self._image_size = image_size
        self._cameras = tuple(cameras)
        self._views: Views | None = None
        if images:
            self._views = Views(
                self.stepper,
                self._domain.look,
                image_size,
                cameras=cameras,
                renderer=renderer,
                quality=image_quality,
            )
        self._seed: int | None = None
        self._episode = 0
        self._elapsed = 0
        self._noise = np.zeros((self._max_episode_steps + 1, noise_size(self._task)))
        size = len(self._task.action_names)
        self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self.observation_space: spaces.Space[Any] = self._space()

    def _space(self) -> spaces.Dict:
        def numbers(size: int) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, (size,), np.float32)

        parts: dict[str, spaces.Space[Any]] = {
            "agent_pos": numbers(len(self._task.state_names))
        }
        if self._obs_type == "state":
            count = len(self._task.environment_state_names)
            parts["environment_state"] = numbers(count)
        else:
            frame = spaces.Box(0, 255, (*self._image_size, 3), np.uint8)
            several = len(self._cameras) > 1
            named = spaces.Dict(dict.fromkeys(self._cameras, frame))
            parts["pixels"] = named if several else frame
        return spaces.Dict(parts)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: the seed's first, the next, or ``options["episode"]``."""
        super().reset(seed=seed)
        if seed is not None:
            self._seed, self._episode = seed, 0
        elif self._seed is None:
            # Gymnasium's rule: without a seed, the episode is unpredictable.
            self._seed = int(self.np_random.integers(2**31))
        episode = (options or {}).get("episode", self._episode)
        if episode < 0:
            raise RlcoError(f"options['episode']={episode}; give 0 or more.")
        # The same random streams as in `TabletopEnv`, for the same episodes.
        rng = np.random.default_rng([self._seed, episode])
        start = self._task.initial_state(rng, self._variation)
        noise = np.random.default_rng([self._seed, episode, Stream.NOISE])
        self._noise[:] = noise.standard_normal(self._noise.shape)
        self._episode, self._elapsed, self._diverged = episode + 1, 0, False
        if self._views is not None:
            self._views.start(_ONE, self._seed, [episode])
        state = self.stepper.reset([start]).at(0)
        self.task_description = self.instructions[int(state.instruction_id)]
        return self._observe(), self._info(state)

    def step(
        self, action: NDArray[np.floating[Any]]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Execute one control step.

        Raises:
            RlcoError: If an action is NaN, infinite, in another unit (ten times beyond
                [-1, 1]), or its shape is not (A,).
        """
        numbers = np.asarray(action, dtype=np.float64)
        if numbers.shape != self.action_space.shape:
            raise RlcoError(
                f"the action has shape {numbers.shape}; give {self.action_space.shape}."
            )
        self._action_range.check(numbers)
        states = self.stepper.step(numbers[None, None])
        before, after = states.at((0, 0)), states.at((0, 1))
        self._elapsed += 1
        if self.stepper.diverged[0]:
            return self._cut_off(after)
        reward = float(self._task.reward(before, after, self._reward_kind))
        info = self._info(after)
        terminated = self._terminate and info["is_success"]
        truncated = self._elapsed >= self._max_episode_steps
        return self._observe(), reward, terminated, truncated, info

    def _cut_off(
        self, last: SceneState
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Return the end of an episode whose simulation diverged, and count it."""
        if not self.divergences:
            _logger.warning(
                "%s; it is cut off. Later ones are only counted, in `divergences`.",
                str(SimulationError(self.task, [0])).rstrip("."),
            )
        self.divergences += not self._diverged
        self._diverged = True
        info = {**self._info(last), "is_success": False, "diverged": True}
        observation = copy.deepcopy(self._last_observation)
        return observation, 0.0, False, True, info

    def _observe(self) -> Observation:
        state = self.stepper.reported_state().at(0)
        # A step beyond the horizon is the caller's choice; it reuses the last noise.
        noise = self._noise[min(self._elapsed, len(self._noise) - 1)]
        robot, environment = observe(self._task, self._domain, state, noise)
        out: Observation = {"agent_pos": robot.astype(np.float32)}
        if self._obs_type == "state":
            out["environment_state"] = environment.astype(np.float32)
        else:
            frames = self._frames()
            out["pixels"] = frames if len(frames) > 1 else frames[self._cameras[0]]
        self._last_observation = copy.deepcopy(out)
        return out

    def _info(self, state: SceneState) -> dict[str, Any]:
        # Python's own types: Gymnasium's vector environments stack those as arrays.
        return {
            "is_success": bool(self._task.success(state)),
            "instruction_id": int(state.instruction_id),
            "diverged": False,
        }

    def _frames(self) -> dict[str, NDArray[np.uint8]]:
        """Return the current frame of each camera, (height, width, 3)."""
        if self._views is None:
            raise RlcoError("the environment is closed; make a new one to render.")
        if not self._diverged:  # otherwise the last images, as there is no valid pose
            self._views.draw(_ONE, np.array([self._elapsed]))
        return {
            name: frames[0].transpose(1, 2, 0).copy()
            for name, frames in self._views.images.items()
        }

    def render(self) -> NDArray[np.uint8] | None:
        """Return the first camera's frame (height, width, 3); None without a mode."""
        return None if self.render_mode is None else self._frames()[self._cameras[0]]

    def close(self) -> None:
        """Free what was kept to render."""
        if self._views is not None:
            self._views.close()
            self._views = None


def _stepper(
    task: Task, domain: Domain, backend: str, exact: bool, variation: str | None
) -> NativeStepper | RobosuiteStepper:
    """Return one world of a task, which marks divergence instead of raising."""
    options: dict[str, Any] = {"variation": variation, "on_divergence": "mark"}
    if backend == "robosuite":
        return RobosuiteStepper(task, domain, num_envs=1, **options)
    return NativeStepper(task, domain, num_envs=1, exact=exact, **options)


def _check(
    given: dict[str, Any], horizon: int | None, image_size: tuple[int, int]
) -> None:
    for kind, value in given.items():
        if value not in _CHOICES[kind]:
            raise UnknownNameError(kind, str(value), [str(c) for c in _CHOICES[kind]])
    if horizon is not None and horizon < 1:
        raise RlcoError(f"horizon={horizon} is not allowed; give 1 or more.")
    check_image_size(image_size)
