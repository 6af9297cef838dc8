"""robosuite's own tasks by name, built so that all their worlds are alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rlco.errors import RlcoError
from rlco.physics.effects.apply import EffectError, library_effect
from rlco.physics.effects.corrected_model import without_effects
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.robosuite.effect_sim import initialize_with
from rlco.physics.robosuite.global_random import seeded
from rlco.physics.robosuite.options import (
    DEFAULTS,
    FIXED,
    check_options,
    environment_class,
    two_arms,
)
from rlco.physics.robosuite.options import PREFIX as PREFIX
from rlco.physics.spec.actions import LIMIT
from rlco.physics.spec.sample import Sample

# robosuite's observations that form `state`, and `environment_state`.
STATE = ("robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos")
ENVIRONMENT_STATE = "object-state"
_INSTRUCTIONS = {
    "Door": "open the door",
    "Lift": "lift the cube",
    "NutAssembly": "put each nut on its peg",
    "NutAssemblyRound": "put the round nut on its peg",
    "NutAssemblySquare": "put the square nut on its peg",
    "PickPlace": "put each object into its bin",
    "PickPlaceBread": "put the bread into its bin",
    "PickPlaceCan": "put the can into its bin",
    "PickPlaceCereal": "put the cereal into its bin",
    "PickPlaceMilk": "put the milk into its bin",
    "Stack": "put the red cube on the green cube",
}


@dataclass(frozen=True)
class RobosuiteTask:
    """The description of one of robosuite's tasks, as of rlco's own.

    Attributes:
        name: ``robosuite:`` and robosuite's name.
        instructions: The one instruction.
        horizon: Length of an episode in control steps, robosuite's 1000 by default.
        control_frequency: Control steps per second [Hz].
        state_names: Name of each dimension of `state`: the tool's position [m] and
            orientation in the world frame, the gripper's joints [m] or [rad].
        environment_state_names: Name of each dimension of robosuite's ``object-state``.
        action_names: Name of each dimension of an action, in [-1, 1].
        training_horizon: Length of a training episode; None: `horizon`.
    """

    name: str
    instructions: tuple[str, ...]
    horizon: int
    control_frequency: int
    state_names: tuple[str, ...]
    environment_state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    training_horizon: int | None = None
    #: Numbers of an action are at most so large.
    action_limit: ClassVar[float] = LIMIT

    @staticmethod
    def of(name: str, env: Any) -> RobosuiteTask:
        """Describe the task of an environment that was reset.

        Raises:
            RlcoError: If it has more than one arm.
        """
        if len(env.robots) != 1 or len(env.robots[0].arms) != 1:
            raise two_arms(name)
        observations = env._get_observations()
        objects = [
            name
            for name, observable in env._observables.items()
            if name in observations and observable.modality == "object"
        ]
        sizes = {key: np.size(value) for key, value in observations.items()}
        tool = [f"tool.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        fingers = [f"gripper.{i}" for i in range(sizes[STATE[2]])]
        arm = env.robots[0].part_controllers[env.robots[0].arms[0]]
        moves = [f"{arm.name.lower()}.{i}" for i in range(arm.control_dim)]
        gripper = ["gripper"] * (env.action_dim - arm.control_dim)
        return RobosuiteTask(
            name=f"{PREFIX}{name}",
            instructions=(_INSTRUCTIONS.get(name, f"solve {name}"),),
            horizon=int(env.horizon),
            control_frequency=int(env.control_freq),
            state_names=(*tool, *fingers),
            environment_state_names=tuple(
                f"{key}.{i}" for key in objects for i in range(sizes[key])
            ),
            action_names=(*moves, *gripper),
        )

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of it, in JSON types."""
        return {
            "task": self.name,
            "instructions": list(self.instructions),
            "control_frequency": self.control_frequency,
            "state_names": list(self.state_names),
            "environment_state_names": list(self.environment_state_names),
            "action_names": list(self.action_names),
        }


def make_plain(
    name: str,
    *,
    seed: int = 0,
    effects: EffectsFile | None = None,
    sample: Sample | None = None,
    **options: Any,
) -> Any:
    """Return one of robosuite's environments, without cameras.

    Its model is compiled once (``hard_reset=False``), so every episode has the same
    objects; robosuite draws their sizes at construction, here from `seed`.

    Args:
        name: robosuite's name, ``Lift``.
        seed: Determines the sizes of objects.
        effects: Effects to add to the model.
        sample: Parameter sets of these effects, which episodes may draw.
        options: robosuite's own, such as ``robots="UR5e"``.

    Raises:
        UnknownNameError: If robosuite has no such environment, option or robot.
        RlcoError: If rlco sets an option itself, robosuite does not accept its value,
            or an effect cannot be applied.

    Example:
        >>> make_plain("Lift", robots="UR5e").action_dim
        7
    """
    kind = environment_class(name)
    check_options(name, options)
    env = kind.__new__(kind)
    if effects is not None:
        # robosuite's constructor compiles the model by this method.
        env._initialize_sim = _WithEffects(env, effects, sample)
    given = {**DEFAULTS, **options}
    try:
        with seeded(seed):
            env.__init__(**{**given, **FIXED})
    except RlcoError:
        raise
    # The exceptions that robosuite raises for rejected values differ by option.
    except (AssertionError, KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise RlcoError(
            f"robosuite does not build {name} with the options {', '.join(given)} as "
            f"given ({reason}); change them."
        ) from error
    return env


class _WithEffects:
    """Replacement of an environment's ``_initialize_sim``."""

    def __init__(self, env: Any, effects: EffectsFile, sample: Sample | None) -> None:
        self._env, self._effects, self._sample = env, effects, sample

    def __call__(self, xml_string: str | None = None) -> None:
        del xml_string  # robosuite's signature; here the model is always its own
        initialize_with(self._env, self._effects, self._sample)
        corrected = self._env.sim.corrected
        if not np.array_equal(
            corrected.reported, without_effects(corrected.model).reported
        ):
            wrong = next(
                effect
                for effect in corrected.effects
                if library_effect(effect.name).on_measurement is not None
            )
            raise EffectError(
                wrong.name,
                wrong.target,
                "robosuite's own observations read the true joints",
                "leave it out, or give one of rlco's tasks",
            )
