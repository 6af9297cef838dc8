"""An arm to practise on: logs of a simulated robot, and a model of it as it is known.

A task's arm moves freely in a domain, and writes down what its encoders report and the
torques that its controller sends. What the domain adds to the nominal simulator is in
the logs and not in the model, as with a robot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.gap.correct.corrected_files import corrected_xml
from rlco.gap.model import load_model
from rlco.physics.effects.corrected_model import Given
from rlco.physics.effects.names import in_model
from rlco.physics.mj.rotations import rotation_vector
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.task import Array, SceneState
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.plain_robosuite import make_robosuite
from rlco.runs.whole_files import check_new_folder, write_text

RATE = 100  # rows of a recording per second
_STEPS = 500  # physics steps per second
# Recordings start about this posture, above the table and far from the joints' limits,
# at most so far from it [rad].
POSTURE = (0.0, 0.0, 0.0, -2.1, 0.0, 2.2, 0.79)
SPREAD = (1.2, 0.15, 0.3, 0.15, 0.3, 0.2, 0.8)
REACH = (0.08, 0.18, 0.1, 0.2, 0.2, 0.2)  # of the tool's swings [m, rad]
GAIN = (5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 0.0)  # of actions that follow them [1/m, 1/rad]
POSITION_NOISE = 1e-4  # [rad]
TORQUE_NOISE = 0.05  # [N m]
_SPARE = 3  # motions that are tried for each recording
_NEAR_LIMIT = 0.05  # [rad]


def record_arm(
    folder: Path | str,
    task: str,
    domain: GivenDomain,
    *,
    recordings: int = 6,
    seconds: float = 10.0,
    seed: int = 0,
    effects: Given = None,
) -> None:
    """Let a task's arm move freely in a domain, and write NPZ files of what it reports.

    Each file has ``time`` (T,) [s], ``position`` (T, joints) [rad], with a noise of
    0.1 mrad, ``torque`` (T, joints) [N m], with a noise of 0.05 N m, and
    ``joint_names``. The arm's model is that of :func:`write_known_model`.

    Args:
        folder: A new folder.
        task: The task's name.
        domain: Where the arm moves.
        recordings: How many, from different postures.
        seconds: Length of a recording [s].
        seed: Of postures, motions and noise.
        effects: Effects that are added to the domain's simulator.

    Raises:
        OutputExistsError: The folder exists.
        RlcoError: It cannot be made, or too few excitation motions are free of contacts
            and limits.
    """
    folder = Path(folder)
    check_new_folder(folder)
    # A torque that is read once in a longer control step is off by what damping has
    # taken since that step began; so each physics step is one.
    spec = replace(make_task(task), control_frequency=_STEPS)
    tried = _SPARE * recordings
    stepper = NativeStepper(spec, make_domain(domain), num_envs=tried, effects=effects)
    rng = np.random.default_rng(seed)
    turned = np.array(SPREAD) * rng.uniform(-1.0, 1.0, (tried, 7))
    stepper.reset(
        [replace(spec.initial_state(rng), joint_position=q) for q in POSTURE + turned]
    )
    position, torque, free = _move(stepper, round(RATE * seconds), rng)
    # An arm that is nearly stretched shakes, faster than rows can follow.
    shake = np.abs(np.diff(position, n=2, axis=0)).max(axis=(0, 2))
    kept = sorted(sorted(np.flatnonzero(free), key=shake.__getitem__)[:recordings])
    if len(kept) < recordings:
        raise RlcoError(
            f"in only {len(kept)} of {tried} motions of {seconds:g} s the arm touched "
            f"nothing and stayed within its joints' limits, and {recordings} are "
            "wanted; take shorter ones, or another seed."
        )
    position += POSITION_NOISE * rng.standard_normal(position.shape)
    torque += TORQUE_NOISE * rng.standard_normal(torque.shape)
    arm = stepper.worlds.control.arm_ctrl
    model = stepper.model
    names = [model.joint(j).name for j in model.actuator_trnid[arm, 0]]
    folder.mkdir(parents=True)
    for number, one in enumerate(kept):
        np.savez(
            folder / f"{number}.npz",
            time=np.arange(len(position)) / RATE,
            position=position[:, one],
            torque=torque[:, one],
            joint_names=np.array(names),
        )


def _move(
    stepper: NativeStepper, rows: int, rng: np.random.Generator
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return positions and torques (rows, N, joints), and which arms moved freely (N,).

    An arm that touches something, or a limit of its joints, is pushed by what no
    encoder reports.
    """
    drive = free_motion(stepper.reported_state(), rng)
    arm = stepper.worlds.control.arm_ctrl
    joints = stepper.model.actuator_trnid[arm, 0]
    low, high = stepper.model.jnt_range[joints].T
    position, torque = np.zeros((2, rows, len(stepper.data), arm.size))
    free = np.ones(len(stepper.data), bool)
    for row in range(rows):
        action = drive(row / RATE, stepper.reported_state())
        stepper.step(np.repeat(action[:, None], _STEPS // RATE, axis=1))
        position[row] = stepper.reported_state().joint_position
        torque[row] = [data.ctrl[arm] for data in stepper.data]
        free &= [not _touches(stepper.model, data) for data in stepper.data]
    inside = (position > low + _NEAR_LIMIT) & (position < high - _NEAR_LIMIT)
    return position, torque, free & inside.all(axis=(0, 2))


def _touches(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Return whether the robot touches the table or an object; fingers may meet."""
    trees = model.body_rootid[model.geom_bodyid[data.contact.geom]]
    ours = np.isin(trees, _robots(model))
    return bool((ours[:, 0] != ours[:, 1]).any())


def _robots(model: mujoco.MjModel) -> NDArray[np.int32]:
    """Return the roots of the kinematic trees that actuators move."""
    joints = model.actuator_trnid[:, 0]
    roots: NDArray[np.int32] = model.body_rootid[model.jnt_bodyid[joints]]
    return np.unique(roots)


def free_motion(
    start: SceneState, rng: np.random.Generator
) -> Callable[[float, SceneState], Array]:
    """Return what swings the tool about where it starts, each axis at its own pace.

    Returns:
        From a time [s] and the reported state, leading axes (N,), to actions (N, 7).
    """
    count = len(start.tool_position)
    pace = 2.0 * np.pi * rng.uniform(0.14, 0.26, (count, 6))  # [rad/s]
    reach = np.array(REACH) * rng.choice([-1.0, 1.0], (count, 6))

    def drive(time: float, state: SceneState) -> Array:
        away = reach * np.sin(pace * time)
        turned = state.tool_rotation @ np.swapaxes(start.tool_rotation, -1, -2)
        action = np.zeros((count, 7))
        action[:, :3] = start.tool_position + away[:, :3] - state.tool_position
        action[:, 3:6] = away[:, 3:] - rotation_vector(turned)
        return np.clip(action * GAIN, -1.0, 1.0)

    return drive


def write_known_model(path: Path | str, task: str, domain: GivenDomain = "sim") -> None:
    """Write a task's scene in a domain as MJCF, for ``find_gap`` as ``model``.

    Args:
        path: The file; its folder is made.
        task: The task's name.
        domain: What is known: the effects of its model are in the file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    env = make_robosuite(task, domain=domain)
    with TemporaryDirectory() as folder:
        nominal = Path(folder) / path.name
        nominal.write_text(env.edit_model_xml(env.model.get_xml()))
        loaded = load_model(nominal)
        effects = in_model(env.domain.model_effects, loaded.model)
        text = corrected_xml(loaded, effects, path.parent)
    write_text(path, text)
