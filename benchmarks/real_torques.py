"""A real Panda's torques against robosuite's model, by inverse dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import real_data

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.torque.convention import torque_problem
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Array, Log
from rlco.gap.make_problem import in_parts
from rlco.gap.model import LoadedModel
from rlco.gap.reference import Prepared, prepare, search
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.fit import Fit, Library, fit, library_of
from rlco.gap.search.intervals import block_bootstrap
from rlco.physics.effects import AppliedEffect

USUAL = {
    "coulomb_friction": "frictionloss",
    "viscous_damping": "damping",
    "armature": "armature",
    "torque_bias": "torque",
}
WRISTS = ("joint6", "joint7")


def rows() -> list[real_data.Row]:
    """Measure, and return the rows of the table."""
    loaded, log = real_data.panda()
    whole = torque_problem(loaded.spec, log)
    verdict = find_gap(TorqueLog(loaded.spec, in_parts(log)))
    before, after = (
        rms(whole, residuals)
        for residuals in (nothing(whole), [one.residual for one in usual(whole)])
    )
    left = verdict.unexplained
    changes = [f"{a:.2f}->{b:.2f}" for a, b in zip(before, after, strict=True)]
    return [
        ("named", real_data.said(verdict), "coulomb_friction joint6, joint7", "-"),
        (
            "left unexplained",
            f"{left['share']:.0%}: {left['note']}",
            "gravity or centre of mass at joint4",
            "offset of 1.8 N m at joint4",
        ),
        (
            "rms [N m], joint by joint, with " + ", ".join(USUAL),
            " ".join(changes),
            "joint6 .35->.20, joint7 .29->.09",
            ".87->.72 1.77->1.03 1.41->.73 2.20->1.10 .75->.57 .35->.20 .29->.09",
        ),
        ("friction of one half in the other's interval", *halves(loaded.spec, log)),
        ("best single effect of joint4", best_of(whole, "joint4"), "gravity", "-"),
        ("command delay, fitted beside the usual", delay(whole), "none", "-"),
        *beside_calibration(loaded, log),
    ]


def beside_calibration(loaded: LoadedModel, log: Log) -> list[real_data.Row]:
    """Calibrate and search, with all of the log and with each half of it."""
    verdict, prepared = _calibrated(loaded, log)
    summary, problem = prepared.summary, prepared.problem
    if summary is None or not isinstance(problem, TorqueLog):
        raise SystemExit("the Panda's torques could not be calibrated")
    nominal = TorqueLog(
        loaded.spec, problem.log, window=problem.window, noise=problem.noise
    )
    held = np.isin(problem.layout.recording, verdict.heldout)
    noise = problem.noise[problem.layout.channel][held]
    before, after = (
        float(np.mean(one.residuals([with_it])[0][held] ** 2 - noise**2))
        for one, with_it in ((nominal, Hypothesis()), (problem, verdict.hypothesis))
    )
    changes = zip(summary.nominal, summary.calibrated, strict=True)
    middle = log.recordings[0].rows // 2
    found = [_named_beyond(loaded, prepared)]
    halves_said = []
    for rows in (slice(0, middle), slice(middle, None)):
        half = replace(log, recordings=(log.recordings[0].take(rows),))
        said, of_half = _calibrated(loaded, half)
        halves_said.append(real_data.said(said))
        found.append(_named_beyond(loaded, of_half))
    return [
        (
            "calibrate=usual: left unexplained",
            f"{after / before:.0%} of the mean square above the noise, held out",
            "30%",
            "-",
        ),
        (
            "calibrate=usual: rms [N m], joint by joint",
            " ".join(f"{one:.2f}->{other:.2f}" for one, other in changes),
            "-",
            "-",
        ),
        (
            "calibrate=usual: named, and in each half",
            "; ".join([real_data.said(verdict), *halves_said]),
            "no name that a half does not confirm",
            "-",
        ),
        (
            "calibrate=usual: numbers beyond their priors, and in each half",
            "; ".join(found),
            "-",
            "-",
        ),
    ]


def _named_beyond(loaded: LoadedModel, prepared: Prepared) -> str:
    """Return in words which numbers a calibration found beyond what is usual."""
    if prepared.summary is None:
        return "not calibrated"
    found = prepared.summary.named(loaded.model)
    return (
        ", ".join(f"{one.name} {one.target or ''}".strip() for one in found) or "none"
    )


def _calibrated(loaded: LoadedModel, log: Log) -> tuple[Verdict, Prepared]:
    prepared = prepare(loaded, log, None, None, 1, lambda said, part: None)
    return search(prepared)


def usual(problem: TorqueLog) -> list[Fit]:
    """Fit the usual four to each joint alone."""
    starts = [
        [AppliedEffect(name, joint, {key: 0.0}) for name, key in USUAL.items()]
        for joint in problem.log.joints
    ]
    fits = []
    for channel, start in enumerate(starts):
        # A joint's own four change its torque alone: the others are only in the way.
        def weigh(
            lists: Sequence[tuple[AppliedEffect, ...]], channel: int = channel
        ) -> Array:
            every = problem.residuals([Hypothesis(tuple(one)) for one in lists])
            return every[:, problem.layout.channel == channel]

        fits += fit(library_of(problem), [start], weigh, steps=4)
    return fits


def nothing(problem: TorqueLog) -> list[Array]:
    """Return the residual of each joint without effects."""
    every = problem.residuals([Hypothesis()])[0]
    return [every[problem.layout.channel == i] for i in range(len(problem.log.joints))]


def rms(problem: TorqueLog, residuals: Sequence[Array]) -> list[float]:
    """Return the root mean square of each joint's residual [N m]."""
    return [float(np.sqrt(np.mean(one**2))) for one in residuals]


def halves(spec: mujoco.MjSpec, log: Log) -> tuple[str, str, str]:
    """Fit each half alone: is a joint's friction within the other half's interval?

    Damping, armature and a bias are free beside it, blocks of a second resampled.
    """
    middle = log.recordings[0].rows // 2
    found: list[dict[str, tuple[float, float, float]]] = []
    for rows in (slice(0, middle), slice(middle, None)):
        half = TorqueLog(spec, replace(log, recordings=(log.recordings[0].take(rows),)))
        seconds = half.layout.time[half.layout.channel == 0].astype(np.int64)
        numbers = {}
        for joint, one in zip(log.joints, usual(half), strict=True):
            draws = block_bootstrap(one.jacobian, one.residual, seconds)[:, 0]
            value = float(one.effects[0].values[0])
            low, high = value + np.quantile(draws, [0.05, 0.95])
            numbers[joint] = (value, float(low), float(high))
        found.append(numbers)
    said = []
    for joint in WRISTS:
        (one, *own), (other, *its) = found[0][joint], found[1][joint]
        held = (own[0] <= other <= own[1], its[0] <= one <= its[1])
        said.append(
            f"{joint}: {one:.2f} [{own[0]:.2f}, {own[1]:.2f}] and {other:.2f} "
            f"[{its[0]:.2f}, {its[1]:.2f}], {sum(held)} of 2 hold"
        )
    return "; ".join(said), "they hold", "0.26 and 0.25"


def best_of(problem: TorqueLog, joint: str) -> str:
    """Return which single effect explains most of one joint's torque."""
    channel = problem.log.joints.index(joint)
    library = library_of(problem)
    starts = [
        [AppliedEffect(one.name, one.target, _start(library, one, start))]
        for one in library
        for start in library[one][0].starts
    ]

    def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        every = problem.residuals([Hypothesis(tuple(one)) for one in lists])
        return every[:, problem.layout.channel == channel]

    before = float(np.mean(nothing(problem)[channel] ** 2))
    fits = sorted(fit(library, starts, weigh, steps=3), key=lambda one: one.cost)
    ranked: dict[str, float] = {}
    for one in fits:
        name = f"{one.effects[0].name} {one.effects[0].target or ''}".strip()
        ranked.setdefault(name, (one.cost / before) ** 0.5)
    return ", ".join(f"{k} leaves {v:.0%}" for k, v in list(ranked.items())[:4])


def delay(problem: TorqueLog) -> str:
    """Fit a delay beside the usual four of all joints."""
    start = [
        AppliedEffect(name, joint, {key: 0.0})
        for joint in problem.log.joints
        for name, key in USUAL.items()
    ]
    start.append(AppliedEffect("command_delay", None, {"delay": 0.02}))
    scale = problem.noise[problem.layout.channel]

    def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        every = problem.residuals([Hypothesis(tuple(one)) for one in lists])
        return every / scale

    found, without = fit(library_of(problem), [start, start[:-1]], weigh, steps=5)
    milliseconds = 1e3 * float(found.effects[-1].values[0])
    gain = 1.0 - (found.cost / without.cost) ** 0.5
    return f"{milliseconds:.1f} ms, which explains {gain:.1%} of what is left"


def _start(library: Library, one: Candidate, start: float) -> dict[str, float]:
    known = library[one]
    return {p.name: start if i == 0 else p.starts[0] for i, p in enumerate(known)}
