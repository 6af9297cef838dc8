"""The content of ``report.json``: the verdict for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco

from rlco.gap.compare.problem import Candidate, Instability
from rlco.gap.compare.verdict import FreeForm, Gap, HeldOut, NamedEffect, Value, Verdict
from rlco.gap.diagnose.where import Where
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
        verdict: The result of the search.
        where: Where the nominal model disagrees with the measurement.
        model: The nominal model; its parameters' bounds close intervals that the data
            leaves open, since JSON has no infinity.
        record_next: Motions that would be more informative.
    """
    closest = [] if verdict.effects else verdict.closest
    content: dict[str, object] = {
        "complete": verdict.complete,
        "verdict": verdict.verdict,
        "effects": [effect_json(finding, model) for finding in verdict.effects],
        "gap": gap_json(verdict.gap, named=bool(verdict.effects)),
        "where": [
            {"target": cell.target, "share": cell.share, "regime": cell.regime}
            for cell in where.informative[:_CELLS]
        ],
        "unexplained": _unexplained(verdict),
        "closest": [_candidate(one) | {"share": share} for one, share in closest],
        "record_next": [dict(motion) for motion in record_next],
        "seconds": verdict.seconds,
        "unstable": _unstable(verdict.instability),
    }
    if verdict.held_out is not None:
        content["held_out"] = _held_out(verdict.held_out)
    if verdict.free_form is not None:
        content["outside"] = _outside(verdict.free_form)
    if verdict.remarks:
        content["remarks"] = list(verdict.remarks)
    return content


def _outside(free: FreeForm) -> dict[str, object]:
    lines = {
        "position": free.over_position,
        "velocity": free.over_velocity,
        "time": free.over_time,
    }
    what = "error" if free.of_encoder else "torque"
    shape = {
        f"over_{name}": {name: x.tolist(), what: y.tolist()}
        for name, (x, y) in lines.items()
        if len(x)
    }
    return {
        "target": free.target,
        "explains": free.gain,
        "predicts": free.predicts,
        **shape,
    }


def _held_out(held_out: HeldOut) -> dict[str, object]:
    return {
        "measure": "mean absolute error, mean over the groups",
        "unit": held_out.unit,
        "nominal": held_out.nominal,
        "before": held_out.before,
        "after": held_out.after,
        "numbers_before": held_out.numbers_before,
        "numbers_after": held_out.numbers_after,
        "groups": [
            {
                "name": group.label,
                "recordings": len(group.recordings),
                "nominal": group.nominal,
                "before": group.before,
                "after": group.after,
            }
            for group in held_out.groups
        ],
    }


def gap_json(gap: Gap, *, named: bool = True) -> dict[str, object]:
    """Return ``gap``: where nothing is named, after equals before."""
    before = _sizes(gap.before_train, gap.before_heldout)
    after = _sizes(gap.after_train, gap.after_heldout) if named else dict(before)
    return {
        "unit": gap.unit,
        "before": before,
        "after": after,
        "noise_floor": gap.noise_floor,
    }


def _unstable(instability: Instability | None) -> dict[str, object] | None:
    if instability is None:
        return None
    recordings = [
        {"name": one.name, "time": one.time, "joint": one.joint, "body": one.body}
        for one in instability.divergences
    ]
    return {
        "recordings": recordings,
        "bounded": instability.bounded,
        "changed": instability.changed,
        "timestep": instability.timestep,
        "implicitfast": instability.implicit,
        "advice": list(instability.advice),
    }


def _unexplained(verdict: Verdict) -> dict[str, object]:
    absent: dict[str, object] = {"share": 0.0, "target": None, "note": ""}
    return {key: verdict.unexplained.get(key, value) for key, value in absent.items()}


def _sizes(train: float, heldout: float) -> dict[str, float | None]:
    """Return two sizes; null where a simulation diverged, as JSON has no infinity."""
    sizes = {"train_rms": train, "heldout_rms": heldout}
    return {name: s if math.isfinite(s) else None for name, s in sizes.items()}


def effect_json(finding: NamedEffect, model: mujoco.MjModel) -> dict[str, object]:
    """Return one entry of ``effects``."""
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
