"""What changed between two recordings of a robot whose model is wrong in many ways.

    python benchmarks/gap_reference.py out=outputs/gap_reference            # one by one
    python benchmarks/gap_reference.py out=outputs/gap_reference groups=[single]

Run it with OMP_NUM_THREADS=1. In the plant every mass, inertia, friction, damping,
armature and gain is 10 to 30 % off the model, up or down. It is recorded, something in
it changes, and it is recorded again, with other motion and other noise. The plant is
that of `gap_plant`, which shares no code with the search. Each finished case is one
line in ``OUT/results.jsonl``: started again it goes on where it was.

Seeds below 1000 are for development; the benchmark's begin at 21000.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from gap_arms import Arm, Array, make_arm
from gap_changes import Case, Config, Row, row_of, run
from gap_motions import MOTIONS, Motion, commands
from gap_plant import Hidden, make_plant
from gap_recording import Recorded, read_out, record
from gap_sizes import draw, usual

from rlco.gap.calibrate.numbers import Calibratable
from rlco.gap.logs.log import Log, Recording
from rlco.gap.make_problem import make_problem
from rlco.gap.model import LoadedModel, load_model
from rlco.gap.reference import changed_problem, search
from rlco.run import run_recipe
from rlco.runs.config import option

BENCHMARK_SEED = 21000
OFF = (0.10, 0.30)  # how far off each number of the model is
EPISODES = 6
EXCITING = replace(MOTIONS["excite"], episodes=EPISODES)
# Inverse dynamics need accelerations, so smooth motion and the encoders of such arms.
SMOOTH = replace(
    MOTIONS["reach"],
    episodes=EPISODES,
    fps=100,
    frames=600,
    noise=1e-4,
    quantum=0.0,
    jitter=0.0,
    velocity=True,
)
_SHORT = 5e-4  # [s]
_TORQUE_NOISE = 0.01  # of a joint's usual torque
#: What changes, and whether that is looked for in torques.
POSITIONS = (
    "payload",
    "coulomb_friction",
    "backlash",
    "actuator_gain",
    "command_delay",
    "joint_offset",
)
TORQUES = ("payload", "coulomb_friction", "torque_scale", "torque_bias")


@dataclass
class ReferenceConfig(Config):
    """Options of gap_reference.py."""

    out: str = option("outputs/gap_reference", "folder; finished cases are kept")
    seed: int = option(BENCHMARK_SEED, "seed of the first case", minimum=0)


def plan(first_seed: int) -> list[Case]:
    """Return all cases: 60 single changes, 20 pairs, 40 of nothing.

    Example:
        >>> [sum(c.group == g for c in plan(0)) for g in ("single", "pair", "none")]
        [60, 20, 40]
    """
    return list(_cases(first_seed))


def _cases(first_seed: int) -> Iterator[Case]:
    arms = cycle(("arm3", "arm6", "so101", "panda"))
    seeds = iter(range(first_seed, first_seed + 100_000))
    random = np.random.default_rng(first_seed)

    def case(group: str, effects: tuple[str, ...], torques: bool) -> Case:
        arm, seed = next(arms), next(seeds)
        kind = "torques" if torques else "positions"
        name = f"{group}_{kind}_{arm}_{seed}"
        return Case(name, group, arm, effects, torques, seed)

    for number in range(60):
        place = (number + number // 20) % 10  # so that each robot has each change
        torques = place >= len(POSITIONS)
        yield case("single", ((*POSITIONS, *TORQUES)[place],), torques)
    for number in range(20):
        torques = number % 5 == 4
        names = TORQUES if torques else POSITIONS
        pair = random.choice(names, 2, replace=False)
        yield case("pair", tuple(map(str, pair)), torques)
    for number in range(40):
        yield case("none", (), number % 5 == 4)


def run_case(case: Case) -> Row:
    """Record a case, search it, and return what was found beside the truth."""
    arm, motion = make_arm(case.arm), SMOOTH if case.torques else EXCITING
    random = np.random.default_rng(case.seed)
    sent = [
        [commands(arm, motion, random) for _ in range(motion.episodes)]
        for _ in range(2)
    ]
    reference = _recorded(case, motion, sent[0], ())
    later = _recorded(case, motion, sent[1], ())
    torque, speed = (
        np.concatenate([getattr(one, name) for one in later])
        for name in ("torque", "velocity")
    )
    used = usual(arm, torque, speed)
    hidden: list[Hidden] = []
    for name in case.effects:
        hidden.append(_drawn(name, arm, used, hidden, random))
    unchanged, later = later, _recorded(case, motion, sent[1], hidden)
    noise = _TORQUE_NOISE * used.torque
    floor = noise if case.torques else np.full(len(arm.joints), motion.noise)
    shows = _shows(case, arm, unchanged, later, hidden) / floor
    logs = [
        _log(
            arm, motion, episodes, commanded, case.torques, noise, hidden * late, random
        )
        for late, (episodes, commanded) in enumerate(
            zip((reference, later), sent, strict=True)
        )
    ]
    began, cpu = time.perf_counter(), time.process_time()
    loaded = _loaded(arm)
    known = make_problem(loaded, logs[0])
    assert isinstance(known, Calibratable)
    prepared = changed_problem(loaded, known, *logs)
    calibrated = time.process_time() - cpu
    verdict, prepared = search(prepared)
    summary, before = prepared.summary, prepared.before
    assert summary is not None
    assert before is not None
    calibration = summary.calibration
    row = row_of(case, verdict, hidden, float(shows.max()))
    return row | {
        "cost": [calibration.cost_before, calibration.cost],
        "noise": (before.unknown / prepared.base.noise).round(2).tolist(),
        "after": (before.after / before.unknown).round(2).tolist(),
        "seconds": round(time.perf_counter() - began, 1),
        "cpu": round(time.process_time() - cpu, 1),
        "cpu_calibration": round(calibrated, 1),
    }


def _shows(
    case: Case,
    arm: Arm,
    before: Sequence[Recorded],
    after: Sequence[Recorded],
    hidden: Sequence[Hidden],
) -> Array:
    """Return how much of the same motion changed, root mean square, (joints,)."""
    name = "torque" if case.torques else "position"
    one, other = (
        np.concatenate([getattr(episode, name) for episode in part])
        for part in (before, after)
    )
    for effect in hidden:
        if effect.name == "torque_scale":
            column = arm.joints.index(str(effect.target))
            other[:, column] *= effect["factor"]
    return np.asarray(np.sqrt(np.mean((other - one) ** 2, axis=0)))


def _drawn(
    name: str, arm: Arm, used: Any, others: Sequence[Hidden], random: Any
) -> Hidden:
    while True:
        if name == "torque_scale":
            joint = str(random.choice(arm.joints))
            factor = float(random.choice([1.0 / 3.0, 0.6, 1.5, 4.0]))
            return Hidden(name, joint, {"factor": factor})
        effect = draw(name, arm, used, 1.0, random)
        if effect.target is None or all(effect.target != o.target for o in others):
            return effect


def _recorded(
    case: Case, motion: Motion, sent: list[Array], hidden: Sequence[Hidden]
) -> list[Recorded]:
    """Record a plant whose numbers are all off the model's.

    Torques are of a drive that interpolates commands: read where a held command
    changes, they would jump.
    """
    # A drive's torque at an instant is that of the step only where steps are short.
    finer = (Hidden("finer_steps", None, {"timestep": _SHORT}),) * case.torques
    xml = make_arm(case.arm).xml
    plant = make_plant(xml, (*hidden, *finer), seed=case.seed, off=OFF)
    random = np.random.default_rng(case.seed + 1)
    if not case.torques:
        return [record(plant, u, motion.fps, random) for u in sent]
    every = round(1.0 / motion.fps / _SHORT)
    found = []
    for u in sent:
        frames, steps = np.arange(len(u)), np.arange(every * len(u)) / every
        fine = np.stack([np.interp(steps, frames, line) for line in u.T], axis=1)
        one = record(plant, fine, motion.fps * every, random)
        found.append(
            Recorded(one.position[::every], one.velocity[::every], one.torque[::every])
        )
    return found


def _log(
    arm: Arm,
    motion: Motion,
    episodes: Sequence[Recorded],
    sent: Sequence[Array],
    torques: bool,
    noise: Array,
    hidden: Sequence[Hidden],
    random: Any,
) -> Log:
    recordings = []
    for number, (episode, commanded) in enumerate(zip(episodes, sent, strict=True)):
        read = read_out(episode, motion, random)
        time_ = np.arange(len(commanded)) / motion.fps
        torque = episode.torque + noise * random.standard_normal(episode.torque.shape)
        for effect in hidden:
            if effect.name == "torque_scale":
                torque[:, arm.joints.index(str(effect.target))] *= effect["factor"]
        recordings.append(
            Recording(
                f"episode {number}",
                time_,
                position=read["observation.state"],
                velocity=read["observation.velocity"],
                command=None if torques else commanded,
                torque=torque if torques else None,
            )
        )
    return Log(tuple(recordings), arm.joints, () if torques else arm.joints)


def _loaded(arm: Arm) -> LoadedModel:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(arm.xml)
        return load_model(path)


def main(config: ReferenceConfig) -> None:
    """Run the cases that are not there yet, and print the table."""
    run(config, plan(config.seed), run_case)


if __name__ == "__main__":
    run_recipe(main, ReferenceConfig)
