"""Cases with a hidden effect, made in any number, each reproducible from its seed.

    python benchmarks/gap_cases.py FOLDER [--groups single pair] [--first-seed 0]

A case is a folder: ``model.xml`` (the nominal robot), ``data/`` (a LeRobot v3 folder,
recorded from a plant that differs from the model) and ``truth.json``. What was hidden
is implemented here a second time, in `gap_plant` and `gap_recording`, and nothing of
rlco is used: what is searched for and what is searched with share no code.

Seeds below 1000 are for development; the benchmark's begin at 11000.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from gap_arms import Arm, Array, make_arm
from gap_folders import write_case
from gap_motions import MOTIONS, Motion, commands
from gap_plant import Hidden, make_plant
from gap_recording import Recorded, read_out, record
from gap_sizes import (
    IN_LIBRARY,
    OUTSIDE,
    OUTSIDE_AT_JOINT,
    UNCOMMON,
    Usual,
    draw,
    usual,
)

DEVELOPMENT_SEED, BENCHMARK_SEED = 0, 11000
# An effect at another joint is drawn where one shows too little.
_TRIES = 6
# Root mean square of what an effect changes, over noise and scatter of the plant, at
# the joint that shows it best: below this, nobody could see it.
_VISIBLE = 1.0
_ON_THE_WAY = {"velocity_limit", "actuator_lag", "backlash"}


@dataclass(frozen=True)
class Case:
    """A case before it is made.

    Attributes:
        name: Of its folder.
        group: ``none``, ``single``, ``pair``, ``triple``, ``outside``, or one of them
            with ``_hard`` or ``_demo``; ``leave_out`` where a search has to do without
            the very effect; ``uncommon``; ``beside``, one effect of the library and one
            outside it; ``four``; ``hobby_single`` and ``hobby_pair``; ``late``,
            commands that arrive late at random.
        arm: One of `gap_arms.ARMS`.
        motion: One of `gap_motions.MOTIONS`.
        effects: Names of what is hidden.
        severity: 1 for typical sizes.
        seed: Decides on everything else.
        exclude: Effects that the search has to do without.
    """

    name: str
    group: str
    arm: str
    motion: str
    effects: tuple[str, ...]
    severity: float
    seed: int
    exclude: tuple[str, ...] = ()


def plan(first_seed: int, groups: Sequence[str] = ()) -> list[Case]:
    """Return the list of cases: all groups, or those that are named.

    Example:
        >>> cases = plan(0)
        >>> len(cases), len({case.name for case in cases})
        (409, 409)
    """
    cases = list(_cases(first_seed))
    return [case for case in cases if not groups or case.group in groups]


def _cases(first_seed: int) -> Iterator[Case]:
    arms = cycle(("arm6", "arm3", "so101", "panda", "servo"))
    large = cycle(("arm6", "arm3", "so101", "panda"))
    seed = iter(range(first_seed, first_seed + 100_000))

    def case(
        group: str,
        motion: str,
        effects: tuple[str, ...],
        severity: float = 1.0,
        exclude: tuple[str, ...] = (),
        arm: str | None = None,
    ) -> Case:
        whole = {"gravity_tilt", "random_delay"} & {*effects}
        robots = large if len(effects) > 1 or whole else arms
        arm, number = arm or next(robots), next(seed)
        name = f"{group}_{arm}_{number}"
        return Case(name, group, arm, motion, effects, severity, number, exclude)

    random = np.random.default_rng(first_seed)
    for severity in (1.0, 0.5, 2.0):
        for name in IN_LIBRARY:
            yield case("single", "excite", (name,), severity)
    for name in IN_LIBRARY:
        yield case("single_hard", "reach", (name,), float(random.choice([1.0, 2.0])))
    for name in IN_LIBRARY:
        yield case("single_demo", "demo", (name,), float(random.choice([1.0, 2.0])))
    for motion, suffix, count in (("excite", "", 20), ("reach", "_hard", 15)):
        for _ in range(count):
            yield case(f"none{suffix}", motion, ())
    for _ in range(5):
        yield case("none_demo", "demo", ())
    several = (("pair", 2, 24, 12), ("triple", 3, 15, 8))
    for group, size, rich, hard in several:
        for motion, suffix, count in (("excite", "", rich), ("reach", "_hard", hard)):
            for _ in range(count):
                names = random.choice(IN_LIBRARY, size, replace=False)
                yield case(f"{group}{suffix}", motion, tuple(map(str, names)))
    for motion, suffix, rounds in (("excite", "", 2), ("reach", "_hard", 1)):
        for name in OUTSIDE * rounds:
            yield case(f"outside{suffix}", motion, (name,), 1.0 if rounds == 1 else 1.5)
    for name in IN_LIBRARY:
        yield case("leave_out", "excite", (name,), 1.0, (name,))
    for name in islice(cycle(UNCOMMON), 50):
        yield case("uncommon", "excite", (name,))
    # Groups that came later draw from a generator of their own.
    random = np.random.default_rng([first_seed, 1])

    def drawn(names: Sequence[str], count: int) -> tuple[str, ...]:
        return tuple(map(str, random.choice(names, count, replace=False)))

    for _ in range(40):
        pair = (*drawn(IN_LIBRARY, 1), *drawn(OUTSIDE_AT_JOINT, 1))
        yield case("beside", "excite", pair)
    for _ in range(20):
        yield case("four", "excite", drawn(IN_LIBRARY, 4))
    for name in drawn(IN_LIBRARY, 20):
        yield case("hobby_single", "hobby", (name,), arm="so101")
    for _ in range(20):
        yield case("hobby_pair", "hobby", drawn(IN_LIBRARY, 2), arm="so101")
    for motion in ("excite", "demo"):
        for _ in range(5):
            yield case("late", motion, ("random_delay",))


def make_case(case: Case, folder: Path) -> dict[str, Any]:
    """Record a case into a folder, and return its truth."""
    arm, motion = make_arm(case.arm), MOTIONS[case.motion]
    random = np.random.default_rng(case.seed)
    sent = [commands(arm, motion, random) for _ in range(motion.episodes)]
    session = _Session(arm, motion, sent, case.seed)
    nominal = session.record(())
    torque = np.concatenate([episode.torque for episode in nominal])
    speed = np.concatenate([episode.velocity for episode in nominal])
    used = usual(arm, torque, speed)
    floor = session.floor(nominal)
    hidden, shows = _hide(case, session, used, floor, random)
    recorded = session.record(hidden, motion.jitter)
    logged = [read_out(episode, motion, random) for episode in recorded]
    for effect in hidden:
        if effect.name == "repeated_frames":
            logged = [_repeated(rows, effect["share"], random) for rows in logged]
    episodes = [{**rows, "action": u} for rows, u in zip(logged, sent, strict=True)]
    truth = _truth(case, motion, hidden, shows)
    write_case(folder, arm.xml, episodes, motion.fps, arm.joints, truth)
    return truth


@dataclass(frozen=True)
class _Session:
    """One robot, and all commands that it gets."""

    arm: Arm
    motion: Motion
    sent: list[Array]
    seed: int

    def record(self, hidden: Sequence[Hidden], jitter: float = 0.0) -> list[Recorded]:
        plant = make_plant(self.arm.xml, hidden, jitter, self.seed)
        count, random = len(self.sent), np.random.default_rng(self.seed + 1)
        return [
            record(plant, u, self.motion.fps, random, (i / count, (i + 1) / count))
            for i, u in enumerate(self.sent)
        ]

    def play(self, hidden: Sequence[Hidden], sent: Array, fps: float) -> Recorded:
        """Send other commands to the robot that was recorded."""
        plant = make_plant(self.arm.xml, hidden, self.motion.jitter, self.seed)
        return record(plant, sent, fps, np.random.default_rng(self.seed + 1))

    def floor(self, nominal: list[Recorded]) -> Array:
        """Return what differs anyhow: noise, rounding, scatter, (joints,) [rad]."""
        noise = self.motion.noise**2 + self.motion.quantum**2 / 12
        scatter = np.zeros(len(self.arm.home))
        if self.motion.jitter:
            scatter = _difference(self.record((), self.motion.jitter), nominal)
        return np.asarray(np.sqrt(noise + scatter**2))


def in_session(arm: str, motion: str, seed: int) -> _Session:
    """Return the robot of a case once more, which waits for commands."""
    return _Session(make_arm(arm), MOTIONS[motion], [], seed)


def _difference(a: Sequence[Recorded], b: Sequence[Recorded]) -> Array:
    """Return the root mean square difference of positions, (joints,) [rad]."""
    rows = [(x.position - y.position) ** 2 for x, y in zip(a, b, strict=True)]
    return np.asarray(np.sqrt(np.concatenate(rows).mean(0)))


def _hide(
    case: Case, session: _Session, used: Usual, floor: Array, random: Any
) -> tuple[tuple[Hidden, ...], list[float]]:
    """Return effects at places where each shows, and how much of the floor it does."""
    hidden: tuple[Hidden, ...] = ()
    shows: list[float] = []
    before = session.record(())
    for name in case.effects:
        tried = []
        for _ in range(_TRIES):
            effect = draw(name, session.arm, used, case.severity, random)
            if any(_clash(effect, other) for other in hidden):
                continue
            after = session.record((*hidden, effect))
            seen = float((_difference(after, before) / floor).max())
            if name == "repeated_frames":
                seen = np.inf
            tried.append((seen, effect, after))
            if seen >= _VISIBLE:
                break
        seen, effect, before = max(tried, key=lambda row: row[0])
        hidden, shows = (*hidden, effect), [*shows, seen]
    return hidden, shows


def _clash(effect: Hidden, other: Hidden) -> bool:
    """Return whether two effects at one place leave open which comes first."""
    both = {effect.name, other.name} <= _ON_THE_WAY
    return effect.target == other.target is not None and both


def _repeated(
    rows: dict[str, Array], share: float, random: np.random.Generator
) -> dict[str, Array]:
    """Return rows of which some are the row before once more."""
    count = len(rows["observation.state"])
    fresh = random.random(count) >= share
    fresh[0] = True
    source = np.maximum.accumulate(np.where(fresh, np.arange(count), 0))
    return {name: values[source] for name, values in rows.items()}


def _as_named(effect: Hidden) -> tuple[Hidden, ...]:
    """Return a hidden effect as what a search should name."""
    numbers = effect.parameters
    if effect.name == "torque_ripple":
        return (Hidden("cogging", effect.target, numbers),)
    if effect.name == "directional_friction":
        friction = {"frictionloss": numbers["frictionloss"]}
        return (
            Hidden("coulomb_friction", effect.target, friction),
            Hidden("torque_bias", effect.target, {"torque": numbers["torque"]}),
        )
    return (effect,)


def _truth(
    case: Case, motion: Motion, hidden: Sequence[Hidden], shows: Sequence[float]
) -> dict[str, Any]:
    effects = []
    named = [
        (part, seen)
        for effect, seen in zip(hidden, shows, strict=True)
        for part in _as_named(effect)
    ]
    for effect, seen in named:
        numbers = dict(effect.parameters)
        row: dict[str, Any] = {"name": effect.name, "target": effect.target}
        row["value"] = next(iter(numbers.values()))
        if effect.name == "payload":
            row["pos"] = [numbers[axis] for axis in "xyz"]
        if effect.outside:
            row["outside"] = True
        row |= {"parameters": numbers, "shows": round(min(seen, 1e6), 2)}
        effects.append(row)
    # Whether what is outside the library acts where what is in it does.
    targets = [row["target"] for row in effects]
    together = {"same_joint": len({*targets}) == 1} if case.group == "beside" else {}
    facts = asdict(motion)
    keys = ("velocity", "noise", "quantum", "episodes", "jitter", "fps")
    return {
        "arm": case.arm,
        "effects": effects,
        "seed": case.seed,
        **{key: facts[key] for key in keys},
        "motion": motion.name,
        "group": case.group,
        **together,
        "severity": case.severity,
        "exclude": list(case.exclude),
        "invisible": [e["name"] for e in effects if e["shows"] < _VISIBLE],
    }


def main() -> None:
    """Make the cases of a list that are not there yet."""
    parser = argparse.ArgumentParser(description="Make cases with hidden effects.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--groups", nargs="*", default=[])
    parser.add_argument("--first-seed", type=int, default=DEVELOPMENT_SEED)
    given = parser.parse_args()
    for case in plan(given.first_seed, given.groups):
        folder = given.folder / case.group / case.name
        if not (folder / "truth.json").exists():
            truth = make_case(case, folder)
            told = [(e["name"], e["target"], e["shows"]) for e in truth["effects"]]
            print(case.name, case.severity, told, flush=True)


if __name__ == "__main__":
    main()
