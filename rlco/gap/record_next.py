"""What to record next: the motion on which rivals differ most.

Rivals are effects that fit the log equally well. Each is fitted to the log, then both
are simulated on motions that the robot could make; what counts is by how much they
still differ when the numbers of one may follow the other, in noise floors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rlco.gap.arm_rollouts import ArmRollouts
from rlco.gap.command_file import write_commands
from rlco.gap.fit import fit, library_of, with_values
from rlco.gap.log import Array, Log, Recording
from rlco.gap.motions import KINDS, SECONDS, Kind, Room, room_of
from rlco.gap.problem import Candidate, Finding, Hypothesis, Problem, Verdict
from rlco.gap.words import title
from rlco.physics.effects import AppliedEffect, Parameter
from rlco.physics.effects.targets import actuated_joint, servo_joints

_WEIGHT = "Repeat one motion with a known weight in the hand, and without it."
#: Motions that are worth recording where nothing can be simulated, by effect.
_BY_HAND = {
    "contact_friction": "Push the object at two speeds, and let it slide freely.",
    "contact_stiffness": "Drop the object from two heights.",
    "object_mass": "Lift the object, hold it for 2 s, and push it.",
    "payload": _WEIGHT,
    "link_inertia": _WEIGHT,
}
# Noise floors below which a difference is not worth a recording: it would raise the
# error of the wrong rival by a tenth.
_CLEAR = 0.5
_PLENTY = 3.0  # and above which more is no better
_STEP = 0.05  # part of a number's size by which it is varied


@dataclass(frozen=True)
class Motion:
    """A motion to record.

    Attributes:
        name: Its name; a folder is called so.
        how: What to do, in a sentence.
        tells_apart: The rivals.
        separation: By how much two rivals differ on it that differ least, root mean
            square in noise floors; None where it was not simulated.
        commands: Goals of the actuators, one row a frame, (T, actuators) [rad or m];
            None where there is nothing to replay.
        names: Of the actuators.
        fps: Goals a second [Hz].
    """

    name: str
    how: str
    tells_apart: tuple[Candidate, ...]
    separation: float | None = None
    commands: Array | None = None
    names: tuple[str, ...] = ()
    fps: int = 0

    def save(self, out: str | Path) -> dict[str, object]:
        """Write the commands below ``out/record_next``; return a row for reports."""
        folder = Path("record_next") / self.name
        if self.commands is not None:
            write_commands(
                Path(out) / folder,
                self.commands,
                names=self.names,
                fps=self.fps,
                task=self.how,
            )
        return {
            "motion": self.name,
            "how": self.how,
            "tells_apart": ", ".join(title(one) for one in self.tells_apart),
            "noise_floors": None
            if self.separation is None
            else round(self.separation, 1),
            "seconds": SECONDS if self.commands is not None else None,
            "commands": str(folder) if self.commands is not None else None,
        }


def recommend(problem: Problem, verdict: Verdict) -> list[Motion]:
    """Return a motion for each class of rivals, and one for joints that hardly moved.

    Args:
        problem: The robot and its log.
        verdict: What was found.
    """
    motions = [
        _for_rivals(problem, verdict, finding)
        for finding in verdict.effects
        if finding.rivals
    ]
    still = _still_joints(problem.log)
    if still or verdict.verdict == "not_identifiable":
        motions.append(_for_still_joints(problem, still))
    return list({motion.name: motion for motion in motions}.values())


def separations(
    problem: Problem,
    one: Sequence[AppliedEffect],
    others: Mapping[Candidate, Sequence[AppliedEffect]],
) -> dict[Candidate, float]:
    """Return by how much sets of effects differ from one on a problem's motions.

    Args:
        problem: What is measured in it does not matter.
        one: Effects with numbers.
        others: By its rival, another set of effects; the numbers of the rival may
            follow `one`, in the first order.

    Returns:
        Root mean squares in noise floors; 0 where a simulation diverges.
    """
    lists: list[tuple[AppliedEffect, ...]] = [tuple(one)]
    parts: dict[Candidate, slice] = {}
    library = library_of(problem)
    for rival, other in others.items():
        varied = _varied(other, rival, library[rival])
        parts[rival] = slice(len(lists), len(lists) + 1 + len(varied))
        lists += [tuple(other), *varied]
    rows = problem.residuals([Hypothesis(effects) for effects in lists])
    rows = rows / problem.noise[problem.layout.channel]
    return {rival: _apart(rows[0], rows[part]) for rival, part in parts.items()}


def _apart(one: Array, rows: Array) -> float:
    """Return what is left of a difference beside the first-order changes of a rival."""
    if not (np.isfinite(one).all() and np.isfinite(rows).all()):
        return 0.0
    difference, changes = one - rows[0], (rows[1:] - rows[0]).T
    numbers = np.linalg.lstsq(changes, difference, rcond=1e-6)[0]
    return float(np.sqrt(np.mean((difference - changes @ numbers) ** 2)))


def _varied(
    effects: Sequence[AppliedEffect], one: Candidate, known: Sequence[Parameter]
) -> list[tuple[AppliedEffect, ...]]:
    """Return the effects with each number of one of them changed a little."""
    out = []
    for parameter in known:
        size = max(abs(start - parameter.neutral) for start in parameter.starts)
        varied = []
        for effect in effects:
            if _candidate(effect) == one:
                value = effect.parameters[parameter.name]
                step = _STEP * max(abs(value - parameter.neutral), 0.2 * size, 1e-6)
                value += step if value + step <= parameter.high else -step
                numbers = {**effect.parameters, parameter.name: value}
                effect = replace(effect, parameters=numbers)
            varied.append(effect)
        out.append(tuple(varied))
    return out


def _for_rivals(problem: Problem, verdict: Verdict, finding: Finding) -> Motion:
    named = Candidate(finding.name, finding.target)
    members = (named, *finding.rivals)
    by_hand = next((_BY_HAND[m.name] for m in members if m.name in _BY_HAND), None)
    servos = set(servo_joints(problem.model))
    if not isinstance(problem, ArmRollouts) or not servos.issuperset(
        problem.log.joints
    ):
        how = by_hand or "Record faster and slower motion, with rests in between."
        return Motion(f"after_{finding.name}", how, members)
    effects = verdict.hypothesis.effects
    rivals = {
        rival: _fitted(problem, verdict, named, rival) for rival in finding.rivals
    }
    room = room_of(problem.model, problem.log)
    motions = []
    for kind in KINDS:
        for columns in _choices(room, members):
            goals = kind.make(room, columns)
            apart = separations(_problem_on(problem, room, goals), effects, rivals)
            least = min(apart.values())
            motions.append(_motion(problem, room, kind, columns, goals, members, least))
    best = max(motions, key=_worth)
    if (best.separation or 0.0) < _CLEAR and by_hand:
        return replace(best, how=f"{best.how} {by_hand}")
    return best


def _worth(motion: Motion) -> tuple[float, float]:
    """Prefer, of motions that tell rivals apart beyond doubt, one of few joints."""
    apart = motion.separation or 0.0
    few = not motion.name.endswith("_all")
    return min(apart, _PLENTY) + (few and apart > _PLENTY), apart


def _fitted(
    problem: Problem, verdict: Verdict, named: Candidate, rival: Candidate
) -> tuple[AppliedEffect, ...]:
    """Return the effects, a rival in the place of what was named, as they fit best."""
    library = library_of(problem)
    rest = [e for e in verdict.hypothesis.effects if _candidate(e) != named]
    known = library[rival]
    starts = [
        [*rest, *with_values(library, [rival], np.array(values))]
        for first in known[0].starts
        for values in [[first, *(p.starts[0] for p in known[1:])]]
    ]
    train = verdict.train
    shown = np.isin(problem.layout.recording, train)
    scale = problem.noise[problem.layout.channel][shown]

    def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        hypotheses = [Hypothesis(effects) for effects in lists]
        return problem.residuals(hypotheses, train) / scale

    return min(fit(library, starts, weigh), key=lambda one: one.cost).effects


def _choices(room: Room, members: Sequence[Candidate]) -> list[list[int]]:
    """Return which joints may move: those that rivals are of, and all together."""
    of = {room.joints.index(m.target) for m in members if m.target in room.joints}
    every = list(range(len(room.joints)))
    return [every] if not of or len(of) == len(every) else [sorted(of), every]


def _still_joints(log: Log) -> list[str]:
    """Return the joints that nearly always stay within a hundredth of a radian."""
    parts = [np.asarray(r.position) for r in log.recordings if r.position is not None]
    if not parts:
        return []
    low, high = np.quantile(np.concatenate(parts), [0.05, 0.95], axis=0)
    spread = high - low
    return [name for name, s in zip(log.joints, spread, strict=True) if s < 0.01]


def _for_still_joints(problem: Problem, still: Sequence[str]) -> Motion:
    joints = list(still) or list(problem.log.joints)
    if not isinstance(problem, ArmRollouts):
        return Motion("more_motion", f"Move {', '.join(joints) or 'it'} more.", ())
    room = room_of(problem.model, problem.log)
    columns = [room.joints.index(name) for name in joints]
    sweep = next(kind for kind in KINDS if kind.name == "fast_sweep")
    goals = sweep.make(room, columns)
    return _motion(problem, room, sweep, columns, goals, (), None)


def _motion(
    problem: ArmRollouts,
    room: Room,
    kind: Kind,
    columns: Sequence[int],
    goals: Array,
    members: tuple[Candidate, ...],
    apart: float | None,
) -> Motion:
    every = len(columns) == len(room.joints)
    moved = "all joints" if every else " and ".join(room.joints[c] for c in columns)
    name = "_".join([kind.name, "all" if every else room.joints[columns[0]]])
    return Motion(
        name=name,
        how=kind.how.format(joint=moved),
        tells_apart=members,
        separation=apart,
        commands=_commands(problem, goals),
        names=problem.log.actuators,
        fps=round(room.rate),
    )


def _commands(problem: ArmRollouts, goals: Array) -> Array:
    """Return the actuators' goals for joint goals, in the log's order."""
    model, joints = problem.model, problem.log.joints
    of = [
        actuated_joint(model, model.actuator(name).id) for name in problem.log.actuators
    ]
    still = np.zeros(len(goals))
    columns = [goals[:, joints.index(j)] if j in joints else still for j in of]
    return np.stack(columns, axis=1)


def _problem_on(problem: ArmRollouts, room: Room, goals: Array) -> ArmRollouts:
    """Return the same robot under other commands."""
    recording = Recording(
        "next",
        room.time,
        position=goals,
        velocity=np.zeros_like(goals),
        command=_commands(problem, goals),
    )
    log = Log((recording,), problem.log.joints, problem.log.actuators)
    return ArmRollouts(problem.spec, log, problem.noise, threads=problem.threads)


def _candidate(effect: AppliedEffect) -> Candidate:
    return Candidate(effect.name, effect.target)
