"""The user's model: an MJCF file or a robosuite task, ready to be compiled often."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from rlco.errors import RlcoError, UnknownNameError
from rlco.gap.slim import compile_whole, slim_down, slim_whole
from rlco.physics.effects import targets

#: Before the name of a robosuite task, where a file's path is expected.
PREFIX = "robosuite:"


@dataclass(frozen=True)
class LoadedModel:
    """A model as the user has it, and what of it decides the motion.

    Attributes:
        name: Its name, or its file's.
        spec: The slim spec: the same motion, see `rlco.gap.slim.slim_down`. Copy it
            before changing it.
        model: What `spec` compiles to.
        source: The user's own XML, to mend.
        path: Where it lies; None for a robosuite task.
        task: Name of the robosuite task, if it is one.
    """

    name: str
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    source: str
    path: Path | None = None
    task: str | None = None

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
        """Names of the bodies that a free joint lets fly."""
        return targets.free_bodies(self.model)


def load_model(model: str | Path) -> LoadedModel:
    """Load an MJCF file, or ``robosuite:TASK``.

    Args:
        model: A file that MuJoCo reads (MJCF or URDF), ``robosuite:push_cube`` for
            one of rlco's own tasks, or ``robosuite:Lift`` for one of robosuite's.

    Raises:
        RlcoError: There is no such file, or MuJoCo does not compile it: its own words
            are in the message.
        UnknownNameError: There is no such task.
    """
    if str(model).startswith(PREFIX):
        return _load_task(str(model))
    path = Path(model)
    if not path.is_file():
        raise RlcoError(
            f"model {str(path)!r} is no file; give an MJCF file, or a task as "
            f"model={PREFIX}push_cube."
        )
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        whole = compile_whole(spec)
    except ValueError as error:
        raise RlcoError(
            f"model {str(path)!r} does not compile; MuJoCo says: {_on_one_line(error)}"
        ) from None
    slim = slim_whole(whole)
    return LoadedModel(
        name=_name(spec, path.stem),
        spec=slim,
        model=slim.copy().compile(),
        source=path.read_text(),
        path=path,
    )


def without_contact(loaded: LoadedModel) -> LoadedModel:
    """Return a model in which nothing touches: for motion in free space.

    The meshes of a robot's links take a hundred times longer to compile than all
    else. Use it only where no contact of the full model is active.
    """
    spec = loaded.spec.copy()
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    slim = slim_down(spec)
    return LoadedModel(
        name=loaded.name,
        spec=slim,
        model=slim.copy().compile(),
        source=loaded.source,
        path=loaded.path,
        task=loaded.task,
    )


def _load_task(name: str) -> LoadedModel:
    # robosuite takes seconds to import, which a model of one's own need not wait for.
    from rlco.physics.quiet_robosuite import robosuite
    from rlco.physics.robosuite_tasks import make_plain
    from rlco.physics.tabletop import Tabletop, make_robosuite
    from rlco.physics.task import TASK_NAMES

    task = name.removeprefix(PREFIX)
    # The class of rlco's own tasks registers itself beside robosuite's.
    theirs = sorted(set(robosuite.ALL_ENVIRONMENTS) - {Tabletop.__name__})
    if task not in (*TASK_NAMES, *theirs):
        raise UnknownNameError("task", task, (*TASK_NAMES, *theirs))
    env = make_robosuite(task) if task in TASK_NAMES else make_plain(task)
    source = env.edit_model_xml(env.model.get_xml())
    slim = slim_down(mujoco.MjSpec.from_string(source))
    return LoadedModel(
        name=task,
        spec=slim,
        model=slim.copy().compile(),
        source=source,
        task=task,
    )


def _name(spec: mujoco.MjSpec, stem: str) -> str:
    # MuJoCo's own name of a model that has none.
    return stem if spec.modelname in ("", "MuJoCo Model") else str(spec.modelname)


def _on_one_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return "; ".join(lines)
