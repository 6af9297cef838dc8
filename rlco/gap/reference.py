"""Calibrate a model, then name what it still lacks, or what changed since.

Two recordings of one robot, before and after something in it changed: the first
calibrates the model and tells what it lacks besides; what the second shows beyond that
is a change.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.gap.calibrate.changed import Changed, weights_of
from rlco.gap.calibrate.fit import Calibration, calibrate, fitted_effects
from rlco.gap.calibrate.numbers import Calibratable
from rlco.gap.calibrate.optimism import optimism
from rlco.gap.calibrate.remaining import SPREAD, Remaining
from rlco.gap.calibrate.residual_model import residual_model
from rlco.gap.calibrate.summary import Before, Summary, sizes, sizes_of
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.comparisons import Compared
from rlco.gap.compare.noise import position_noise
from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.compare.stability.instability import UnstableModelError, check_stable
from rlco.gap.compare.torque.convention import factors_between, with_factors
from rlco.gap.compare.torque.smooth_motion import rows_of
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Array, Log
from rlco.gap.make_problem import compared_in, in_parts, make_problem
from rlco.gap.model import LoadedModel
from rlco.gap.search.find_gap import find_gap, nothing_searched
from rlco.gap.search.steps.start import split
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import apply_to_spec

if TYPE_CHECKING:
    from rlco.gap.demos.replay.task_space import TaskSpaceProblem

CALIBRATE = ("none", "usual")
NO_CHANGE = "no_change"
_QUIET = ("no_gap", "no_improvement")
# What a calibration fits is not searched beside it: it is reported as calibrated.
FITTED = (
    "coulomb_friction",
    "viscous_damping",
    "armature",
    "payload",
    "link_inertia",
    "actuator_gain",
    "torque_bias",
    "torque_scale",
    "torque_offset",
)
WINDOWS = (0.1, 0.2)  # other ones for the smoothing of motion [s]
BRIEFLY = 2  # steps of a calibration that chooses one
Step = Callable[[int], None]


@dataclass(frozen=True)
class Prepared:
    """A problem in which a calibration is known.

    Attributes:
        problem: To be searched by `search`.
        summary: The calibration; None where the model's simulation diverges, or where
            the calibration was interrupted.
        before: What is known from recordings made before; None without any.
        stopped: Whether it was interrupted.
    """

    problem: Problem
    summary: Summary | None = None
    before: Before | None = None
    stopped: bool = False

    @property
    def base(self) -> Problem:
        """The comparison itself, without what was known before."""
        return self.problem.base if isinstance(self.problem, Changed) else self.problem


def calibrates(calibrate: str | None, reference: bool, compare: str | None) -> bool:
    """Return whether a model is calibrated before a search.

    Args:
        calibrate: One of `CALIBRATE`; None for ``usual`` with a reference.
        reference: Whether there are recordings made before.
        compare: What is compared.

    Raises:
        UnknownNameError: `calibrate` is another word.
        RlcoError: The options contradict each other.
    """
    if calibrate not in (None, *CALIBRATE):
        raise UnknownNameError("calibration", str(calibrate), CALIBRATE)
    if reference and calibrate == "none":
        raise RlcoError(
            "reference= calibrates the model with those recordings, and calibrate=none "
            "forbids it; leave calibrate= out."
        )
    usual = reference or calibrate == "usual"
    if usual and compare == "both":
        raise RlcoError(
            "a calibration is by one comparison, and compare=both asks for two; give "
            "compare=positions or compare=torques."
        )
    return usual


def prepare(
    loaded: LoadedModel,
    log: Log,
    before: Log | None,
    compare: Compared | None,
    threads: int,
    say: Callable[[str, float], None],
    exclude: Collection[str] = (),
) -> Prepared:
    """Return a problem beside a calibration, from recordings before or of its own.

    Raises:
        DataError: If the recordings are of a kind that is not supported.
    """
    option = "calibrate=usual" if before is None else "reference="
    known = make_problem(loaded, before or log, threads=threads, compare=compare)

    def on_step(step: int) -> None:
        say(f"calibrating, step {step + 1}", 0.0)

    try:
        if before is not None and compared_in(known) == "task":
            return changed_in_task(known, before, log, threads, exclude, say)
        calibrated = _calibratable(known, option)
        nominal = known.residuals([Hypothesis()])[0]
        check_stable(known, nominal, np.zeros((0, len(nominal))))
        if before is None:
            return calibrated_problem(loaded, calibrated, on_step)
        return changed_problem(loaded, calibrated, before, log, on_step)
    except UnstableModelError:
        return Prepared(known)
    except KeyboardInterrupt:
        return Prepared(known, stopped=True)


def calibrated_problem(
    loaded: LoadedModel, known: Calibratable, on_step: Step | None = None
) -> Prepared:
    """Return the problem of what a calibration of the model does not explain.

    The recordings that a search holds out are not used in the calibration, either.

    Args:
        loaded: The model.
        known: It and its recordings.
        on_step: Called after each step of the calibration.
    """
    train = split(known)[0]
    known, calibration = _calibrated(loaded, known, train, on_step)
    effects = fitted_effects(known, calibration)
    model = calibrated_model(loaded, effects)
    remaining = Remaining.of_prior(calibration, loaded.spec)
    problem = _again(known, model, known.log, known.noise, remaining)
    return Prepared(problem, _summary(known, problem, calibration, effects))


def changed_problem(
    loaded: LoadedModel,
    known: Calibratable,
    before: Log,
    after: Log,
    on_step: Step | None = None,
) -> Prepared:
    """Return the problem of what changed between two recordings of one robot.

    Args:
        loaded: The model.
        known: It and the recordings of the robot as it was.
        before: The same recordings as they were read.
        after: Recordings after the change.
        on_step: Called after each step of the calibration.

    Raises:
        DataError: If the two are not comparable.
    """
    _check_same(known, before, after)
    known, calibration = _calibrated(loaded, known, None, on_step)
    effects = fitted_effects(known, calibration)
    model = calibrated_model(loaded, effects)
    remaining = Remaining.of(calibration, loaded.spec)
    parts = in_parts(after)
    if isinstance(known, TorqueLog):
        # A torque that changes its unit or sign has changed: it is not converted.
        parts = with_factors(parts, factors_between(in_parts(before), known.log))
        later = _again(known, model, parts, None, remaining)
    else:
        noise = np.asarray(position_noise(parts).deviation)
        later = _again(known, model, parts, noise, remaining)
    again = _again(known, model, known.log, known.noise, remaining)
    rested, weight, channel = weights_of(again), weights_of(later), later.layout.channel
    residual = again.residuals([Hypothesis()])[0] * rested
    lacking = residual_model(again, residual, later)
    unknown = lacking.deviation * optimism(again, residual, calibration)
    # Of mean square one in each channel: sizes stay those of the rows.
    earlier = 1.0 / sizes(rested, again.layout.channel, len(unknown))
    usual = 1.0 / sizes(weight, channel, len(unknown))
    # Where a joint rested for long before, it left little by its weight alone.
    unknown = np.maximum(earlier, usual) * unknown
    unknown = np.maximum(unknown, np.maximum(later.noise, known.noise))
    lacked = usual[channel] * lacking.correction
    problem = Changed(later, lacked, unknown, usual[channel] * weight)
    size = sizes_of(problem, Hypothesis())
    seconds = sum(one.seconds for one in before.recordings)
    told = Before(
        lacking.explained, unknown, size, size, len(before.recordings), seconds
    )
    summary = _summary(known, again, calibration, effects)
    return Prepared(problem, summary, told)


def changed_in_task(
    known: Problem,
    before: Log,
    after: Log,
    threads: int,
    exclude: Collection[str],
    say: Callable[[str, float], None],
) -> Prepared:
    """Return the problem of what changed between demonstrations of one task.

    What the simulator lacks in those before is named by a search, and taken as known.
    """
    # robosuite, which logs of joints need not wait for.
    from rlco.gap.calibrate.changed_task import changed_task

    def on_step(said: str, part: float) -> None:
        say(f"before: {said}", 0.0)

    task = cast("TaskSpaceProblem", known)
    lacking = find_gap(task, exclude=exclude, on_step=on_step)
    if lacking.instability is not None or not lacking.complete:
        return Prepared(task, stopped=not lacking.complete)
    found = changed_task(task, before, after, lacking, threads)
    return Prepared(found.problem, found.summary, found.before)


def search(
    prepared: Prepared,
    *,
    exclude: Collection[str] = (),
    on_step: Callable[[str, float], None] | None = None,
) -> tuple[Verdict, Prepared]:
    """Return the verdict of a search beside a calibration, and what it leaves.

    Args:
        prepared: The problem.
        exclude: Names of effects that are not considered.
        on_step: Called with a sentence and the fraction completed.
    """
    if prepared.stopped:
        return nothing_searched(prepared.problem, 0.0), prepared
    if prepared.summary is None:  # the verdict is that the simulation diverges
        return find_gap(prepared.problem, on_step=on_step), prepared
    before = prepared.before
    known = () if before is not None else FITTED
    verdict = find_gap(
        prepared.problem, spread=SPREAD, exclude={*exclude, *known}, on_step=on_step
    )
    if before is None:
        return replace(verdict, calibrated=True), prepared
    if verdict.verdict in _QUIET and verdict.complete:
        # Shares of a difference within what is not known would mean nothing.
        verdict = replace(verdict, verdict=NO_CHANGE, closest=())
    verdict = replace(verdict, since_reference=True)
    changed = sizes_of(prepared.problem, verdict.hypothesis)
    if prepared.summary.calibration is None:
        names = prepared.problem.layout.channels
        changed = changed[[names.index(name) for name in prepared.summary.channels]]
    return verdict, replace(prepared, before=replace(before, changed=changed))


def calibrated_model(
    loaded: LoadedModel, effects: tuple[AppliedEffect, ...]
) -> LoadedModel:
    """Return a model with the effects of a calibration."""
    spec = loaded.spec.copy()
    apply_to_spec(spec, effects)
    return replace(loaded, spec=spec, model=spec.copy().compile())


def _calibratable(problem: Problem, option: str) -> Calibratable:
    if isinstance(problem, Calibratable):
        return problem
    raise DataError(
        f"{option} needs recordings of commands and joint positions, or of joint "
        "positions and torques; a free body and a servo's bench cannot be compared so, "
        "and demonstrations of a task by reference= alone: give such recordings, or "
        "leave it out."
    )


def _calibrated(
    loaded: LoadedModel,
    known: Calibratable,
    recordings: tuple[int, ...] | None,
    on_step: Step | None,
) -> tuple[Calibratable, Calibration]:
    """Return a calibration, and the problem that it is of.

    Accelerations of fast motion need shorter windows than slow or noisy ones. The best
    window is that in which a brief calibration leaves the least.
    """
    if not isinstance(known, TorqueLog):
        return known, calibrate(known, recordings, on_step)
    period = min(float(np.median(np.diff(r.time))) for r in known.log.recordings)
    options: dict[int, TorqueLog] = {rows_of(known.window, period): known}
    for window in WINDOWS:
        problem = TorqueLog(loaded.spec, known.log, window=window, noise=known.noise)
        options.setdefault(rows_of(window, period), problem)
    costs = {
        rows: calibrate(one, recordings, on_step, steps=BRIEFLY).cost
        for rows, one in options.items()
        if len(options) > 1
    }
    best = known
    if costs:
        best = options[min(costs, key=lambda rows: costs[rows])]
    return best, calibrate(best, recordings, on_step)


def _again(
    known: Calibratable,
    model: LoadedModel,
    log: Log,
    noise: Array | None,
    calibration: Remaining,
) -> Calibratable:
    """Return the same comparison of a log with the calibrated model."""
    if isinstance(known, TorqueLog):
        return TorqueLog(
            model.spec,
            log,
            window=known.window,
            noise=noise,
            calibration=calibration,
        )
    return ArmRollouts(
        model.spec,
        log,
        np.asarray(noise),
        horizon=known.horizon,
        threads=known.threads,
        calibration=calibration,
    )


def _summary(
    known: Problem,
    calibrated: Problem,
    calibration: Calibration,
    effects: tuple[AppliedEffect, ...],
) -> Summary:
    layout = known.layout
    before, after = (sizes_of(one, Hypothesis()) for one in (known, calibrated))
    return Summary(calibration, effects, layout.channels, layout.units, before, after)


def _check_same(known: Calibratable, before: Log, after: Log) -> None:
    if before.joints != after.joints:
        raise DataError(
            f"reference= has the joints {', '.join(before.joints)}, and data= has "
            f"{', '.join(after.joints)}; give two recordings of one robot."
        )
    first = after.recordings[0]
    if isinstance(known, TorqueLog):
        lacking = "torques" if first.torque is None else None
    else:
        sent = first.command is not None and before.actuators == after.actuators
        lacking = None if sent else f"commands of {', '.join(before.actuators)}"
    if lacking or first.position is None:
        raise DataError(
            f"reference= holds {lacking or 'positions'}, and data= does not; give two "
            "recordings of one kind."
        )
