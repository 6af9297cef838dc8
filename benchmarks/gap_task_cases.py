"""Cases in task space: demonstrations of robosuite tasks with a hidden effect.

    python benchmarks/gap_task_cases.py FOLDER [--first-seed 0] [--rounds 1]

A case is a folder: ``model.txt`` (the name of the nominal model, such as
``robosuite:push_cube``), ``data/`` (a LeRobot v3 folder of the task's own actions, the
tool's pose and what the camera saw of the objects) and ``truth.json``. Give the folder
to ``gap_naming.py`` as ``extra``.

The scripted expert plays in closed loop, as a person would, on a plant whose compiled
arrays were changed: nothing of the effects that are searched for is used.

Seeds below 1000 are for development; those of benchmarks are larger.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from gap_arms import Array
from gap_cases import DEVELOPMENT_SEED
from gap_folders import write_lerobot
from gap_plant import Hidden

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM, Domain
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.sensors import Sensors
from rlco.physics.spec.task import SceneState
from rlco.physics.tasks.make_task import make_task

EPISODES = 9
_HAND_NOISE = 0.1  # of commanded moves, in parts of their range
_HOLD = 15  # control steps kept after the task is solved
# A good arm's repeatability, and a camera that sees objects to a millimetre.
SENSORS = Domain("logged", sensors=Sensors(state_noise=0.0003, object_noise=0.001))
# What differs by less than this many times the sensors' noise nobody could see.
_VISIBLE = 1.0
PUSHED, PLACED, SLIDE = "red_cube_main", "red_main", "cabinet_slide"


@dataclass(frozen=True)
class Case:
    """A case before it is made: a task, what is hidden in it, and a seed."""

    name: str
    task: str
    effects: tuple[Hidden, ...]
    seed: int


def plan(first_seed: int, rounds: int = 1) -> list[Case]:
    """Return the list of cases.

    Example:
        >>> cases = plan(0)
        >>> len(cases), len({case.name for case in cases})
        (16, 16)
    """
    return list(_cases(first_seed, rounds))


def size(random: np.random.Generator, low: float, high: float) -> float:
    """Draw a size, as likely in each factor of two."""
    return round(float(np.exp(random.uniform(np.log(low), np.log(high)))), 4)


def _cases(first_seed: int, rounds: int) -> Iterator[Case]:
    seed = first_seed
    for number in range(rounds):
        random = np.random.default_rng([first_seed, number])

        some = partial(size, random)

        def at(name: str, target: str | None, **numbers: float) -> Hidden:
            return Hidden(name, target, numbers)

        joint = f"robot0_joint{random.integers(1, 7)}"
        late = 0.05 * float(random.integers(1, 3))
        slippery = at("contact_friction", None, friction=some(0.12, 0.25))
        heavy = at("object_mass", PUSHED, factor=some(2.5, 5.0))
        planned: list[tuple[str, tuple[Hidden, ...]]] = [
            ("push_cube", ()),
            ("push_cube", (heavy,)),
            ("push_cube", (slippery,)),
            ("push_cube", (at("command_delay", None, delay=late),)),
            ("push_cube", (at("coulomb_friction", joint, frictionloss=some(2, 6)),)),
            ("push_cube", (at("viscous_damping", joint, damping=some(8, 24)),)),
            ("push_cube", (at("actuator_gain", joint, factor=some(0.75, 0.9)),)),
            ("push_cube", (at("command_delay", None, delay=0.05), slippery)),
            ("pick_and_place", ()),
            (
                "pick_and_place",
                (at("object_mass", PLACED, factor=some(4.0, 8.0)),),
            ),
            ("pick_and_place", (at("command_delay", None, delay=late),)),
            ("open_drawer", ()),
            (
                "open_drawer",
                (at("coulomb_friction", SLIDE, frictionloss=some(2.0, 6.0)),),
            ),
            ("open_drawer", (at("viscous_damping", SLIDE, damping=some(15, 40)),)),
            ("close_drawer", ()),
            (
                "close_drawer",
                (at("coulomb_friction", SLIDE, frictionloss=some(2.0, 6.0)),),
            ),
        ]
        for task, effects in planned:
            kind = "_".join(effect.name for effect in effects) or "none"
            yield Case(f"task_{task}_{kind}_{seed}", task, effects, seed)
            seed += 1


def make_case(case: Case, folder: Path) -> dict[str, Any]:
    """Record a case into a folder, and return its truth."""
    hidden, shows = play(case), 0.0
    if case.effects:
        shows = apart(hidden, play(replace(case, effects=()), hidden))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.txt").write_text(f"robosuite:{case.task}\n")
    write_demonstrations(folder / "data", case.task, hidden)
    truth = _truth(case, shows)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def write_demonstrations(folder: Path, task: str, episodes: Sequence[Episode]) -> None:
    """Write demonstrations as a LeRobot v3 folder, each column by its own name."""
    made = make_task(task)
    write_lerobot(
        folder,
        [episode.rows for episode in episodes],
        made.control_frequency,
        STATE_NAMES,
        made.instructions[0],
    )
    _name_columns(folder, made.environment_state_names)


@dataclass(frozen=True)
class Episode:
    """One recorded episode: its columns, and where tool and objects truly were."""

    rows: dict[str, Array]
    places: Array


@cache
def _robot(task: str) -> NativeStepper:
    return NativeStepper(make_task(task), SIM, num_envs=EPISODES, threads=1)


def play(case: Case, played: list[Episode] | None = None) -> list[Episode]:
    """Let the expert play, or play its actions once more; return the episodes."""
    task, robot = make_task(case.task), _robot(case.task)
    _hide(robot, case.effects)
    rngs = [np.random.default_rng([case.seed, i]) for i in range(EPISODES)]
    starts = [replace(task.sample(rng, None), instruction_id=0) for rng in rngs]
    state = robot.reset(starts)
    told, seen, sent, places, solved = [], [], [], [], []
    for step in range(task.horizon):
        draws = np.stack([rng.standard_normal(noise_size(task) + 3) for rng in rngs])
        robot_told, scene = observe(task, SENSORS, state, draws[:, 3:])
        action = task.expert(state)
        action[:, :3] += _HAND_NOISE * draws[:, :3]
        if played is not None:
            action = np.stack([_row(one.rows["action"], step) for one in played])
        action = np.clip(action, -1.0, 1.0)
        told.append(robot_told)
        seen.append(scene)
        sent.append(action)
        places.append(_places(state))
        state = robot.step(action[:, None]).at(np.s_[:, 1])
        solved.append(task.success(state))
    names = ("observation.state", "observation.environment_state", "action")
    episodes = []
    for i, done in enumerate(np.stack(solved, axis=1)):
        ends = np.flatnonzero(~done)
        length = min(task.horizon, (int(ends[-1]) if ends.size else 0) + 2 + _HOLD)
        if played is not None:
            length = len(played[i].places)
        columns = [np.stack(part)[:length, i] for part in (told, seen, sent)]
        rows = dict(zip(names, columns, strict=True))
        episodes.append(Episode(rows, np.stack(places)[:length, i]))
    return episodes


def _row(actions: Array, step: int) -> Array:
    return np.asarray(actions[min(step, len(actions) - 1)])


def _places(state: SceneState) -> Array:
    """Return where tool and objects are, (episodes, 3 + 3 objects), [m]."""
    objects = state.object_position.reshape(len(state.tool_position), -1)
    return np.concatenate([state.tool_position, objects], axis=1)


def _hide(robot: NativeStepper, effects: tuple[Hidden, ...]) -> None:
    """Write effects into the arrays of all copies' models."""
    everyone, model = np.arange(EPISODES), robot.model
    robot.worlds.restore_models(everyone)
    fields: dict[str, Any] = {}
    delay = 0

    def array(name: str) -> Any:
        return fields.setdefault(name, getattr(model, name).copy())

    for effect in effects:
        match effect.name:
            case "object_mass":
                body = model.body(str(effect.target)).id
                array("body_mass")[body] *= effect["factor"]
                array("body_inertia")[body] *= effect["factor"]
            case "contact_friction":
                array("geom_friction")[:, 0] = effect["friction"]
            case "coulomb_friction":
                dof = model.joint(str(effect.target)).dofadr[0]
                array("dof_frictionloss")[dof] += effect["frictionloss"]
            case "viscous_damping":
                dof = model.joint(str(effect.target)).dofadr[0]
                array("dof_damping")[dof] += effect["damping"]
            case "actuator_gain":
                joint = model.joint(str(effect.target)).id
                actuator = int(np.flatnonzero(model.actuator_trnid[:, 0] == joint)[0])
                array("actuator_gainprm")[actuator, 0] *= effect["factor"]
            case "command_delay":
                delay = round(effect["delay"] * robot.task.control_frequency)
            case other:
                raise KeyError(f"{other} cannot be hidden in a task")
    robot.randomise(everyone, fields, command_delay=delay)


def apart(some: list[Episode], others: list[Episode]) -> float:
    """Return how far places part with the same actions, in sensors' noise."""
    away = [a.places - b.places for a, b in zip(some, others, strict=True)]
    size = np.sqrt((np.concatenate(away) ** 2).mean(axis=0))
    noise = np.full(len(size), SENSORS.sensors.object_noise)
    noise[:3] = SENSORS.sensors.state_noise
    return float((size / noise).max())


def _name_columns(folder: Path, scene: tuple[str, ...]) -> None:
    """Give each feature the names of its own numbers."""
    path = folder / "meta" / "info.json"
    info = json.loads(path.read_text())
    for feature, names in (
        ("observation.state", STATE_NAMES),
        ("observation.environment_state", scene),
        ("action", ACTION_NAMES),
    ):
        told = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
        info["features"][feature] = told
    path.write_text(json.dumps(info, indent=4))


def _truth(case: Case, shows: float) -> dict[str, Any]:
    effects = [
        {
            "name": effect.name,
            "target": effect.target,
            "value": next(iter(effect.parameters.values())),
            "parameters": dict(effect.parameters),
            "shows": round(shows, 2),
        }
        for effect in case.effects
    ]
    return {
        "arm": case.task,
        "effects": effects,
        "seed": case.seed,
        "velocity": False,
        "noise": SENSORS.sensors.state_noise,
        "quantum": 0.0,
        "episodes": EPISODES,
        "jitter": 0.0,
        "fps": make_task(case.task).control_frequency,
        "motion": "expert",
        "group": "task",
        "severity": 1.0,
        "exclude": [],
        "invisible": [e["name"] for e in effects if e["shows"] < _VISIBLE],
    }


def main() -> None:
    """Make the cases of a list that are not there yet."""
    parser = argparse.ArgumentParser(description="Make cases in task space.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first-seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--rounds", type=int, default=1)
    given = parser.parse_args()
    for case in plan(given.first_seed, given.rounds):
        folder = given.folder / "task" / case.name
        if not (folder / "truth.json").exists():
            truth = make_case(case, folder)
            told = [(e["name"], e["target"], e["shows"]) for e in truth["effects"]]
            print(case.name, told, flush=True)


if __name__ == "__main__":
    main()
