"""The user's model: an MJCF file, a robosuite task or a servo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from rlco.errors import RlcoError, UnknownNameError
from rlco.gap import servo_models
from rlco.gap.declared import check_text, text_of
from rlco.gap.model_options import check_options
from rlco.gap.prune import compile_whole, prune, prune_whole
from rlco.gap.servo_models import Pendulum, Servo, pendulum_xml, servo_named
from rlco.gap.trial import does_not_compile, try_model
from rlco.physics.effects import targets
from rlco.physics.mj.libmujoco import silenced_warnings

#: Prefix of a robosuite task's name, given in place of a file's path.
PREFIX = "robosuite:"
# A placeholder until the recordings, which give the pendulum, are read.
_ANY = Pendulum(mass=0.5, length=0.1, volts=5.0)


@dataclass(frozen=True)
class LoadedModel:
    """The user's model, and the pruned spec that has the same motion.

    Attributes:
        name: Its name, or its file's.
        spec: The pruned spec: the same motion, see `rlco.gap.prune.prune`. Copy it
            before changing it.
        model: `spec`, compiled.
        source: The user's own XML, to correct.
        path: Its file; None for a robosuite task and for a servo.
        task: Name of the robosuite task, if it is one.
        servo: The servo, if the model is a servo on its bench.
        pendulum: The servo's load.
    """

    name: str
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    source: str
    path: Path | None = None
    task: str | None = None
    servo: Servo | None = None
    pendulum: Pendulum | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of all hinges and slides, in the model's order."""
        return targets.joints(self.model)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of all actuators, in the model's order."""
        return tuple(self.model.actuator(i).name for i in range(self.model.nu))

    @property
    def free_bodies(self) -> tuple[str, ...]:
        """Names of the bodies on a free joint."""
        return targets.free_bodies(self.model)


def load_model(model: str | Path, *, root: str | Path | None = None) -> LoadedModel:
    """Load an MJCF file, ``robosuite:TASK`` or ``bam:SERVO``.

    Args:
        model: A file that MuJoCo reads (MJCF or URDF), ``robosuite:push_cube`` for
            one of rlco's own tasks, ``robosuite:Lift`` for one of robosuite's, or
            ``bam:xl330`` for a servo on BAM's bench.
        root: The folder in which all files lie that a model's file reads; None: that
            of the model, or of the ROS package around it.

    Raises:
        RlcoError: There is no such file, it reads files elsewhere, or MuJoCo cannot
            compile it; the message quotes MuJoCo.
        UnknownNameError: There is no such task, or no such servo.
    """
    if str(model).startswith(servo_models.PREFIX):
        name = str(model).removeprefix(servo_models.PREFIX)
        return load_servo(servo_named(name), _ANY)
    if str(model).startswith(PREFIX):
        return _load_task(str(model))
    path = Path(model)
    if not path.is_file():
        raise RlcoError(
            f"model {str(path)!r} is not a file; give an MJCF file, or a task as "
            f"model={PREFIX}push_cube, or a servo as model={servo_models.PREFIX}xl330."
        )
    source = text_of(path, errors="strict")
    check_text(path, source, None if root is None else Path(root))
    try_model(path, source)
    try:
        with silenced_warnings():
            spec = mujoco.MjSpec.from_file(str(path))
            check_options(path, spec.option)
            whole = compile_whole(spec)
    except RlcoError:
        raise
    except ValueError as error:
        raise does_not_compile(path, str(error)) from None
    slim = prune_whole(whole)
    return LoadedModel(
        name=_name(spec, path.stem),
        spec=slim,
        model=slim.copy().compile(),
        source=source,
        path=path,
    )


def load_servo(servo: Servo, pendulum: Pendulum) -> LoadedModel:
    """Return the model of a servo that drives a pendulum.

    Example:
        >>> from rlco.gap.servo_models import SERVOS
        >>> load_servo(SERVOS["xl330"], Pendulum(0.5, 0.1, 5.0)).actuators
        ('servo',)
    """
    source = pendulum_xml(servo, pendulum)
    spec = mujoco.MjSpec.from_string(source)
    return LoadedModel(
        name=servo.name,
        spec=spec,
        model=spec.copy().compile(),
        source=source,
        servo=servo,
        pendulum=pendulum,
    )


def _load_task(name: str) -> LoadedModel:
    # robosuite takes seconds to import, which users' own models should not wait for.
    from rlco.physics.robosuite.faster.release import release
    from rlco.physics.robosuite.robosuite_api import robosuite
    from rlco.physics.robosuite.tabletop import Tabletop
    from rlco.physics.robosuite.tasks import make_plain
    from rlco.physics.spec.names import TASK_NAMES
    from rlco.physics.tasks.plain_robosuite import make_robosuite

    task = name.removeprefix(PREFIX)
    # The class of rlco's own tasks registers itself beside robosuite's.
    theirs = sorted(set(robosuite.ALL_ENVIRONMENTS) - {Tabletop.__name__})
    if task not in (*TASK_NAMES, *theirs):
        raise UnknownNameError("task", task, (*TASK_NAMES, *theirs))
    env = make_robosuite(task) if task in TASK_NAMES else make_plain(task)
    source = env.edit_model_xml(env.model.get_xml())
    release(env)
    slim = prune(mujoco.MjSpec.from_string(source))
    return LoadedModel(
        name=task,
        spec=slim,
        model=slim.copy().compile(),
        source=source,
        task=task,
    )


def _name(spec: mujoco.MjSpec, stem: str) -> str:
    # The second is MuJoCo's default for a model without a name.
    return stem if spec.modelname in ("", "MuJoCo Model") else str(spec.modelname)
