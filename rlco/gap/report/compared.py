"""The other comparisons and their results: for programs and for people."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from rlco.gap.compare.comparisons import Comparison, check_line
from rlco.gap.compare.torque.check import carried_over
from rlco.gap.compare.wording import title
from rlco.gap.report.report_json import effect_json, gap_json
from rlco.gap.report.verdict_text import headline


def compared_json(
    comparisons: Sequence[Comparison], model: mujoco.MjModel
) -> dict[str, object]:
    """Return the list ``comparisons`` of ``report.json``.

    Args:
        comparisons: Those of a finding.
        model: The model as it is.
    """
    rows = []
    for one in comparisons:
        found = one.verdict
        effects = () if found is None else found.effects
        named = found is None or bool(effects)
        rows.append(
            {
                "compared": one.compared,
                "searched": found is not None,
                "verdict": None if found is None else found.verdict,
                "effects": [effect_json(effect, model) for effect in effects],
                "gap": None if one.gap is None else gap_json(one.gap, named=named),
                "doubtful": one.warned,
                "notes": list(one.notes),
            }
        )
    return {"comparisons": rows}


def comparison_lines(comparisons: Sequence[Comparison]) -> list[str]:
    """Describe the result of the second comparison, with warnings."""
    lines = []
    for one in comparisons:
        if one is comparisons[0]:
            pass
        elif one.verdict is None and one.warned:
            lines.append(f"Measured torques cannot check this. {one.notes[0]}")
            continue
        elif one.verdict is None:
            first = comparisons[0].verdict
            effects = () if first is None else carried_over(first.hypothesis).effects
            lines.append(check_line(one, [title(effect) for effect in effects]))
        else:
            lines.append(f"By {one.compared} alone: {headline(one.verdict)}")
        if one is not comparisons[0] or not one.warned:
            lines += one.notes if one.warned or one.verdict is not None else []
    return list(dict.fromkeys(lines))
