"""What to do now: the box at the top of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rlco.gap.compare.comparisons import Comparison
from rlco.gap.compare.stability.instability import UNSTABLE
from rlco.gap.compare.verdict import Verdict
from rlco.gap.compare.wording import in_words, listed, title
from rlco.gap.diagnose.proposals import NO_MOTION
from rlco.gap.report.verdict_text import is_loud, nearest

_USE = (
    "Use the corrected model: model.xml in MuJoCo, effects.yaml for training "
    '(make_env(task, domain="effects.yaml")), which also has what MJCF cannot express.'
)
_CALIBRATED = (
    "Use the calibrated model, which reproduces these recordings: model.xml, "
    "effects.yaml. What was fitted is listed below."
)
_RECORD = "Record the motions proposed below, add them to the data, and run this again."
_OTHERWISE: Mapping[str, str] = {
    "no_gap": "Nothing: the model reproduces these recordings.",
    "no_change": "Nothing: the robot behaves as before.",
    "no_improvement": "Record more, under the same conditions: what fits some of these "
    "recordings does not generalise to the others.",
    "unexplained": "See below where the model disagrees; if you know what is missing "
    "there, add an effect of your own (effects_code=).",
    "not_identifiable": "Record faster and wider motion: these recordings excite too "
    "little.",
    UNSTABLE: "Correct the model as described below, and run this again.",
}


def next_steps(
    verdict: Verdict,
    record_next: Sequence[Mapping[str, object]] = (),
    comparisons: Sequence[Comparison] = (),
) -> list[str]:
    """Return what to do after a verdict, in order.

    Args:
        verdict: The result of the search.
        record_next: Motions that would be more informative.
        comparisons: All comparisons, that of the verdict first.
    """
    steps = []
    if comparisons and comparisons[0].warned:
        warning = comparisons[0].notes[0]
        return [
            "Compare positions under the recorded commands (compare=positions), and do "
            f"not act on this: {warning}"
        ]
    if not verdict.complete:
        steps.append("Run the search to the end: it was stopped early.")
    found = [str(motion.get("motion", "")) for motion in record_next]
    motions = [in_words(name) for name in found if not name.startswith(NO_MOTION)]
    silent = [
        str(motion.get("tells_apart", ""))
        for motion, name in zip(record_next, found, strict=True)
        if name.startswith(NO_MOTION)
    ]
    named = f" ({listed(motions)})" if all(motions) and motions else ""
    if verdict.verdict == "ambiguous":
        rivals = {title(rival) for one in verdict.effects for rival in one.rivals}
        if motions and not silent:
            steps.append(
                f"Record what is proposed below{named}: it distinguishes "
                f"{listed([title(one) for one in verdict.effects if one.rivals])} from "
                f"{listed(sorted(rivals), 'or')}."
            )
        elif motions:
            steps.append(f"Record what is proposed below{named}.")
        steps += [
            f"No motion of these joints tells these apart: {one}. Another load, or a "
            "measurement beside the joints, may."
            for one in silent
        ]
        steps.append(
            "Until then the corrected model (model.xml, effects.yaml) is valid for "
            "motion like the recorded one: there, all these explanations agree."
        )
    elif verdict.effects:
        steps.append(_USE)
        if is_loud(verdict):
            steps.append(
                "Treat it with caution: what stays unexplained is far above the noise, "
                "see below."
            )
    elif (near := nearest(verdict)) is not None:
        steps.append(
            "If you are sure of the numbers of the model, run this again with less "
            f"tolerance (spread=0.003): it says how large {title(near[0])} is. If you "
            "are not, let them be fitted first (calibrate=usual)."
        )
        if motions:
            steps.append(_RECORD)
    else:
        calibrated = verdict.calibrated and verdict.verdict == "no_gap"
        steps.append(_CALIBRATED if calibrated else _OTHERWISE[verdict.verdict])
        if motions:
            steps.append(_RECORD)
    if verdict.free_form is not None:
        what = "error of the encoder" if verdict.free_form.of_encoder else "torque"
        steps.append(
            f"Look at the {what} at {verdict.free_form.target} that is drawn below; if "
            "you know its shape, add it as an effect of your own."
        )
    return steps
