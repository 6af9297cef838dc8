"""What ``report.json`` holds: the verdict for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco

from rlco.gap.nothing_yet import NOTE
from rlco.gap.problem import Candidate, Finding, Value, Verdict
from rlco.gap.where import Where
from rlco.physics.effects import EFFECTS

_CELLS = 20


def report(
    verdict: Verdict,
    where: Where,
    model: mujoco.MjModel,
    record_next: Sequence[Mapping[str, object]] = (),
) -> dict[str, object]:
    """Return the content of ``report.json``.

    Args:
        verdict: What was found.
        where: Where the model as it is disagrees with the measurement.
        model: The model as it is; its parameters' bounds end intervals that the data
            leaves open, since JSON has no infinity.
        record_next: Motions that would tell more.
    """
    gap = verdict.gap
    before = _sizes(gap.before_train, gap.before_heldout)
    after = _sizes(gap.after_train, gap.after_heldout)
    closest = [] if verdict.effects else verdict.closest
    return {
        "complete": verdict.complete,
        "verdict": verdict.verdict,
        "effects": [_effect(finding, model) for finding in verdict.effects],
        "gap": {
            "unit": gap.unit,
            "before": before,
            "after": after if verdict.effects else dict(before),
            "noise_floor": gap.noise_floor,
        },
        "where": [
            {"target": cell.target, "share": cell.share, "regime": cell.regime}
            for cell in where.telling[:_CELLS]
        ],
        "unexplained": _unexplained(verdict),
        "closest": [_candidate(one) | {"share": share} for one, share in closest],
        "record_next": [dict(motion) for motion in record_next],
        "seconds": verdict.seconds,
    }


def _unexplained(verdict: Verdict) -> dict[str, object]:
    absent: dict[str, object] = {"share": 0.0, "target": None, "note": ""}
    told = {key: verdict.unexplained.get(key, value) for key, value in absent.items()}
    begun = verdict.effects or verdict.closest or verdict.trail
    if not verdict.complete and not begun and told["note"] != NOTE:
        # Else a share of 1 would read as if the whole library had been of no help.
        told["note"] = f"{NOTE} {told['note']}".rstrip()
    return told


def _sizes(train: float, heldout: float) -> dict[str, float | None]:
    """Return two sizes; null where a simulation diverged, as JSON has no infinity."""
    sizes = {"train_rms": train, "heldout_rms": heldout}
    return {name: s if math.isfinite(s) else None for name, s in sizes.items()}


def _effect(finding: Finding, model: mujoco.MjModel) -> dict[str, object]:
    known = EFFECTS[finding.name].parameters(model, finding.target)
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in known}
    return {
        "name": finding.name,
        "target": finding.target,
        "parameters": {
            name: _value(value, *bounds[name])
            for name, value in finding.parameters.items()
        },
        "rivals": [_candidate(rival) for rival in finding.rivals],
    }


def _value(value: Value, least: float, most: float) -> dict[str, object]:
    return {
        "value": value.value,
        "low": value.low if math.isfinite(value.low) else least,
        "high": value.high if math.isfinite(value.high) else most,
        "unit": value.unit,
    }


def _candidate(candidate: Candidate) -> dict[str, object]:
    return {"name": candidate.name, "target": candidate.target}
