"""Report a model whose simulation is unstable before a search, with advice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.compare.arm.divergence import (
    first_divergence,
    is_stable_implicitly,
    stable_timestep,
)
from rlco.gap.compare.problem import Divergence, Hypothesis, Instability, Problem, Run
from rlco.gap.compare.stability.chatter import find_chatter
from rlco.gap.compare.stability.servo_stability import JointServo, joint_servo
from rlco.gap.compare.verdict import Gap, Verdict
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import ONE_AXIS
from rlco.physics.mj.libmujoco import silenced_warnings

UNSTABLE = "unstable_model"
_LIGHT = 1e-3  # a link lighter than this is suspicious [kg]
_SMALL = 1e-6  # so is a joint with less inertia [kg m^2]


class UnstableModelError(DataError):
    """Raised if the simulation of the recordings diverges without any effect."""

    def __init__(self, instability: Instability) -> None:
        self.instability = instability
        super().__init__(f"{summary(instability)}; {instability.advice[0]}")


def summary(instability: Instability) -> str:
    """Describe the first instability of a model's simulation, without a full stop.

    Example:
        >>> summary(Instability((Divergence(0, "run", 0.25, "elbow"),)))
        "the model's simulation diverges: at joint 'elbow', 0.250 s into 'run'"
    """
    first = min(instability.divergences, key=lambda one: one.time)
    where = f"at joint {first.joint!r}, " if first.joint else ""
    if not first.joint and first.body:
        where = f"at body {first.body!r}, "
    location = f"{where}{first.time:.3f} s into {first.name!r}"
    if instability.bounded:
        return f"the model's simulation swings to and fro at every step: {location}"
    if instability.changed:
        kind, name = changed_words(instability.changed)
        location += f", where the {kind} of {name!r} is one per cent larger"
    return f"the model's simulation diverges: {location}"


def changed_words(name: str) -> tuple[str, str]:
    """Return the kind of a model parameter and the element it belongs to.

    Example:
        >>> changed_words("gain:elbow"), changed_words("solref")
        (('gain', 'elbow'), ('solref', 'contacts'))
    """
    kind, _, of = name.partition(":")
    return kind, of or "contacts"


def check_stable(problem: Problem, nominal: Array, moved: Array) -> None:
    """Refuse a model that is unstable as it is, or with one parameter 1 % larger.

    Args:
        problem: Robot and log.
        nominal: Residuals without any effect, (N,).
        moved: Change of the residuals by each tolerance parameter, (spread, N).

    Raises:
        UnstableModelError: If it is unstable.
    """
    lost = ~np.isfinite(nominal)
    if lost.any():
        raise UnstableModelError(_divergence(problem, Hypothesis(), lost))
    if chatter := find_chatter(problem):
        found = Instability(
            chatter.divergences, True, None, chatter.timestep, chatter.implicit
        )
        raise UnstableModelError(_advised(found, chatter.runs))
    wild = np.flatnonzero(~np.isfinite(moved).all(axis=1))
    if len(wild):
        changed = problem.tolerance_names[wild[0]]
        parts = tuple(0.01 * (name == changed) for name in problem.tolerance_names)
        lost = ~np.isfinite(moved[wild[0]])
        found = _divergence(problem, Hypothesis((), parts), lost)
        raise UnstableModelError(replace(found, changed=changed))


def unstable_verdict(
    problem: Problem,
    instability: Instability,
    train: tuple[int, ...],
    heldout: tuple[int, ...],
    seconds: float,
) -> Verdict:
    """Return the verdict for an unstable model, without a search."""
    nominal = problem.residuals([Hypothesis()])[0]

    def rms(recordings: tuple[int, ...]) -> float:
        rows = nominal[np.isin(problem.layout.recording, recordings)]
        return float(np.sqrt(np.mean(rows**2))) if rows.size else np.nan

    units = set(problem.layout.units)
    noise = problem.noise[problem.layout.channel]
    before = rms(train), rms(heldout)
    first = min(instability.divergences, key=lambda one: one.time)
    note = f"nothing was searched: {summary(instability)}"
    return Verdict(
        complete=True,
        verdict=UNSTABLE,
        effects=(),
        gap=Gap(
            units.pop() if len(units) == 1 else "mixed",
            *before,
            *before,
            float(np.sqrt(np.mean(noise**2))),
        ),
        unexplained={"share": 1.0, "target": first.joint or first.body, "note": note},
        closest=(),
        seconds=seconds,
        hypothesis=Hypothesis(),
        train=train,
        heldout=heldout,
        instability=instability,
    )


def _divergence(
    problem: Problem, hypothesis: Hypothesis, lost: NDArray[np.bool_]
) -> Instability:
    """Locate the divergence; `lost` marks residuals that are not finite, (N,)."""
    layout, found, wild = problem.layout, list[Divergence](), list[Run]()
    with silenced_warnings():
        for recording in np.unique(layout.recording[lost]).tolist():
            runs = problem.runs(hypothesis, [recording])
            each = ((run, first_divergence(run, problem.log)) for run in runs)
            pair = next(((run, one) for run, one in each if one is not None), None)
            if pair is None:
                time = layout.time[lost & (layout.recording == recording)].min()
                name = problem.log.recordings[recording].name
                found.append(Divergence(recording, name, float(time)))
            else:
                wild.append(pair[0])
                found.append(pair[1])
    if not wild:
        advice = "Check the recorded states: the simulation starts from them."
        return Instability(tuple(found), advice=(advice,))
    timestep, implicit = stable_timestep(wild), is_stable_implicitly(wild)
    return _advised(Instability(tuple(found), False, None, timestep, implicit), wild)


def _advised(found: Instability, runs: Sequence[Run]) -> Instability:
    """Add advice on the first of some rollouts that goes wrong."""
    run = min(runs, key=lambda one: one.time)
    first = next(one for one in found.divergences if one.recording == run.recording)
    advice = (_remedies(run.model, found), *_joint_advice(run, first))
    return replace(found, advice=advice)


def _remedies(model: mujoco.MjModel, found: Instability) -> str:
    own, kind = 1e3 * float(model.opt.timestep), 'integrator="implicitfast"'
    ways = [kind] if found.implicit else []
    if found.timestep is not None:
        ways.append(f"a time step of {1e3 * found.timestep:.3g} ms, not {own:.3g} ms")
    if ways:
        what = "swing" if found.bounded else "diverge"
        return f"With {' or with '.join(ways)}, these recordings do not {what}."
    return (
        f"With a 64th of the time step, {own / 64:.3g} ms, it is no better: check for "
        "a gain or damping of the wrong sign, and for masses, inertias and limits that "
        "do not match the robot."
    )


def _joint_advice(run: Run, divergence: Divergence) -> list[str]:
    """Return advice on the joint that diverged first."""
    model, advice = run.model, []
    body = None if divergence.body is None else model.body(divergence.body).id
    joint = divergence.joint
    single = joint is not None and model.joint(joint).type[0] in ONE_AXIS
    if joint is not None and single:
        servo = joint_servo(model, run.qpos, joint)
        advice += _servo_advice(model, joint, servo)
        light = body is not None and model.body_mass[body] < _LIGHT
        if servo.inertia < _SMALL or light:
            advice.append(
                f"Its link {divergence.body!r} weighs "
                f"{float(model.body_mass[body or 0]):.3g} kg: is a mass, an inertia or "
                "an armature missing, or in another unit?"
            )
    if divergence.touching:
        pairs = [f"{a or 'a body'} and {b or 'a body'}" for a, b in divergence.touching]
        advice.append(
            f"Before it diverged, {_few(pairs)} touched: check their solref, solimp "
            "and masses."
        )
    return advice


def _few(pairs: Sequence[str]) -> str:
    return "; ".join(pairs[:3]) + ("; and others" if len(pairs) > 3 else "")


def _servo_advice(model: mujoco.MjModel, joint: str, servo: JointServo) -> list[str]:
    advice, step = [], float(model.opt.timestep)
    if servo.stiffness < 0.0:
        advice.append(
            f"{joint!r} is pushed away from its command: its total stiffness is "
            f"{servo.stiffness:.3g}; check the signs of gains."
        )
    if servo.braking < 0.0:
        advice.append(
            f"{joint!r} is accelerated along its motion: its total damping is "
            f"{servo.braking:.3g}; check the signs of gains and damping."
        )
    if advice or (servo.stiffness == 0.0 and servo.braking == 0.0):
        return advice
    slide = model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    pull, brake, unit = (
        ("N/m", "N s/m", "kg") if slide else ("N m/rad", "N m s/rad", "kg m^2")
    )
    values = (
        f"Servo, spring and damping of {joint!r} have a stiffness of "
        f"{servo.stiffness:.3g} {pull} and a damping of {servo.braking:.3g} {brake} on "
        f"{servo.inertia:.3g} "
        f"{unit}"
    )
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return [f"{values}."]
    critical, lacking = servo.critical, servo.lacking(step)
    if critical > step:
        largest = f"{1e3 * critical:.3g} ms"
        return [
            f"{values}: by themselves they are stable up to a time step of {largest}."
        ]
    return [
        f"{values}: by themselves they are stable up to a time step of "
        f"{1e3 * critical:.3g} ms, or with {lacking:.3g} {unit} added, such as an "
        f"armature of {lacking + float(model.dof_armature[_dof(model, joint)]):.3g} "
        f"{unit}."
    ]


def _dof(model: mujoco.MjModel, joint: str) -> int:
    return int(model.jnt_dofadr[model.joint(joint).id])
