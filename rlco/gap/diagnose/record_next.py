"""Recommend what to record next: the motions that tell rivals apart, or that none does.

Rivals are effects that fit the log equally well. Each is fitted to the log, and all are
simulated on motions that the robot could make. Which of these are proposed, see
`rlco.gap.diagnose.proposals`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis, Problem
from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.compare.verdict import NamedEffect, Verdict
from rlco.gap.diagnose.motions import (
    KINDS,
    Kind,
    Workspace,
    usual_ways,
    workspace_of,
)
from rlco.gap.diagnose.proposals import Motion as Motion
from rlco.gap.diagnose.proposals import Trial, proposed
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.search.fit import fit, library_of, with_values
from rlco.physics.effects import EFFECTS, AppliedEffect, Parameter
from rlco.physics.effects.targets import (
    actuated_joint,
    command_at,
    is_servo,
    servo_joints,
)

_BENCH = (
    "Record the same motions with a heavier and a lighter pendulum and with another "
    "supply voltage, each at a low and at a high gain: a loss, a limit and a gain of "
    "the drive grow differently with the torque that is asked for. Log the current, if "
    "the servo reports it."
)
_STEP = 0.05  # finite difference of a parameter, as a fraction of its size


def recommend(problem: Problem, verdict: Verdict) -> list[Motion]:
    """Return motions for each class of rivals, and one for joints that hardly moved.

    Rivals that no motion tells apart have an entry without commands that says so.

    Args:
        problem: The robot and its log.
        verdict: The result of the search.
    """
    motions = [
        motion
        for finding in verdict.effects
        if finding.rivals
        for motion in _for_rivals(problem, verdict, finding)
    ]
    still = _still_joints(problem)
    if still or verdict.verdict == "not_identifiable":
        motions.append(_for_still_joints(problem, still))
    return list({motion.name: motion for motion in motions}.values())


def separations(
    problem: Problem,
    one: Sequence[AppliedEffect],
    others: Mapping[Candidate, Sequence[AppliedEffect]],
) -> dict[Candidate, float]:
    """Return the differences of sets of effects from one on a problem's motions.

    Args:
        problem: Its measurements do not matter.
        one: Effects with parameters.
        others: Another set of effects for each rival; the parameters of the rival may
            follow `one`, to first order.

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
    """Return a difference less the first-order changes by a rival's parameters."""
    if not (np.isfinite(one).all() and np.isfinite(rows).all()):
        return 0.0
    difference, changes = one - rows[0], (rows[1:] - rows[0]).T
    parameters = np.linalg.lstsq(changes, difference, rcond=1e-6)[0]
    return float(np.sqrt(np.mean((difference - changes @ parameters) ** 2)))


def _varied(
    effects: Sequence[AppliedEffect], one: Candidate, known: Sequence[Parameter]
) -> list[tuple[AppliedEffect, ...]]:
    """Return the effects with each parameter of one of them changed slightly."""
    out = []
    for parameter in known:
        size = max(abs(start - parameter.neutral) for start in parameter.starts)
        varied = []
        for effect in effects:
            if _candidate(effect) == one:
                value = effect.parameters[parameter.name]
                step = _STEP * max(abs(value - parameter.neutral), 0.2 * size, 1e-6)
                value += step if value + step <= parameter.high else -step
                parameters = {**effect.parameters, parameter.name: value}
                effect = replace(effect, parameters=parameters)
            varied.append(effect)
        out.append(tuple(varied))
    return out


def _for_rivals(
    problem: Problem, verdict: Verdict, finding: NamedEffect
) -> list[Motion]:
    named = Candidate(finding.name, finding.target)
    members = (named, *finding.rivals)
    known = [EFFECTS[member.name].by_hand for member in members]
    by_hand = next((how for how in known if how), None)
    servos = set(servo_joints(problem.model))
    if isinstance(problem, ServoBench):
        return [Motion("other_loads", _BENCH, members)]
    if not isinstance(problem, ArmRollouts) or not servos.issuperset(
        problem.log.joints
    ):
        how = by_hand or "Record faster and slower motion, with rests in between."
        return [Motion(f"after_{finding.name}", how, members)]
    effects = verdict.hypothesis.effects
    rivals = {
        rival: _fitted(problem, verdict, named, rival) for rival in finding.rivals
    }
    workspace = workspace_of(problem.model, problem.log)
    trials = []
    for kind in KINDS:
        for columns in _choices(workspace, members):
            goals = kind.make(workspace, columns)
            other = _problem_on(problem, workspace, goals)
            motion = _motion(problem, workspace, kind, columns, goals, members, None)
            apart = separations(other, effects, rivals)
            trials.append(Trial(motion, apart, len(other.layout.recording)))
    return proposed(named, finding.rivals, trials, by_hand)


def _fitted(
    problem: Problem, verdict: Verdict, named: Candidate, rival: Candidate
) -> tuple[AppliedEffect, ...]:
    """Return the best-fitting effects with a rival replacing the named effect."""
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

    def whiten(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        hypotheses = [Hypothesis(effects) for effects in lists]
        return problem.residuals(hypotheses, train) / scale

    return min(fit(library, starts, whiten), key=lambda one: one.cost).effects


def _choices(workspace: Workspace, members: Sequence[Candidate]) -> list[list[int]]:
    """Return sets of joints to move: each of the rivals' joints, and all together."""
    of = {
        workspace.joints.index(m.target)
        for m in members
        if m.target in workspace.joints
    }
    every = list(range(len(workspace.joints)))
    return [every] if not of or len(of) == len(every) else [sorted(of), every]


def _still_joints(problem: Problem) -> list[str]:
    """Return the joints that nearly always stay within 0.01 rad, or 1 mm."""
    log = problem.log
    parts = [np.asarray(r.position) for r in log.recordings if r.position is not None]
    if not parts:
        return []
    low, high = np.quantile(np.concatenate(parts), [0.05, 0.95], axis=0)
    ways = (high - low) / usual_ways(problem.model, log.joints)
    return [name for name, s in zip(log.joints, ways, strict=True) if s < 0.01]


def _for_still_joints(problem: Problem, still: Sequence[str]) -> Motion:
    joints = list(still) or list(problem.log.joints)
    servos = servo_joints(problem.model)
    if not isinstance(problem, ArmRollouts) or not set(servos).issuperset(joints):
        return Motion("more_motion", f"Move {', '.join(joints) or 'it'} more.", ())
    workspace = workspace_of(problem.model, problem.log)
    columns = [workspace.joints.index(name) for name in joints]
    sweep = next(kind for kind in KINDS if kind.name == "fast_sweep")
    goals = sweep.make(workspace, columns)
    return _motion(problem, workspace, sweep, columns, goals, (), None)


def _motion(
    problem: ArmRollouts,
    workspace: Workspace,
    kind: Kind,
    columns: Sequence[int],
    goals: Array,
    members: tuple[Candidate, ...],
    apart: float | None,
) -> Motion:
    every = len(columns) == len(workspace.joints)
    moved = (
        "all joints" if every else " and ".join(workspace.joints[c] for c in columns)
    )
    name = "_".join([kind.name, "all" if every else workspace.joints[columns[0]]])
    return Motion(
        name=name,
        how=kind.how.format(joint=moved),
        tells_apart=members,
        separation=apart,
        commands=_commands(problem, goals),
        names=problem.log.actuators,
        fps=round(workspace.rate),
    )


def _commands(problem: ArmRollouts, goals: Array) -> Array:
    """Return the actuators' commands for joint goals, in the log's order.

    What drives no joint of the log, or is no servo, is sent what it was mostly sent.
    """
    model, log = problem.model, problem.log
    sent = np.concatenate([np.asarray(r.command, dtype=float) for r in log.recordings])
    found = np.tile(np.median(sent, axis=0), (len(goals), 1))
    for column, name in enumerate(log.actuators):
        actuator = int(model.actuator(name).id)
        joint = actuated_joint(model, actuator)
        if joint in log.joints and is_servo(model, actuator):
            goal = goals[:, log.joints.index(joint)]
            found[:, column] = command_at(model, actuator) * goal
    return found


def _problem_on(
    problem: ArmRollouts, workspace: Workspace, goals: Array
) -> ArmRollouts:
    """Return the problem of the same robot under other commands."""
    recording = Recording(
        "next",
        workspace.time,
        position=goals,
        velocity=np.zeros_like(goals),
        command=_commands(problem, goals),
    )
    log = Log((recording,), problem.log.joints, problem.log.actuators)
    return ArmRollouts(problem.spec, log, problem.noise, threads=problem.threads)


def _candidate(effect: AppliedEffect) -> Candidate:
    return Candidate(effect.name, effect.target)
