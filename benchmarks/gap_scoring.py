"""How an answer is judged against what was hidden, and the table of all answers.

`exact` and `fine` follow the rules that score one case at a time: an effect is right
where name and place are, `exact` asks for all of them and no other, `fine` also takes
a class of at most three that is said to be ambiguous. What does not show at all in the
data need not be named, and may be. Where one effect of the library acts beside one
outside it, the first has to be named, and the other reported at its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from gap_likelihood import distinguishable

from rlco.reporting.statistics import wilson_interval

Row = Mapping[str, Any]
# What a payload's target may be called where links are welded to one another.
_ALIAS = {"right_hand": {"right_hand", "link7", "right_gripper"}}
_LARGEST_CLASS = 3
# A told part of the gap that stays, above which a name is not a confident one.
_TOLD_SHARE = 0.1
_QUIET = ("no_gap", "no_improvement", "not_identifiable")


def same(answer: Row, truth: Row) -> bool:
    """Return whether an answer's effect is one that was hidden."""
    if answer["name"] != truth["name"]:
        return False
    wanted = truth["target"]
    return wanted is None or answer["target"] in _ALIAS.get(wanted, {wanted})


@dataclass(frozen=True)
class Score:
    """One answer, judged.

    Attributes:
        exact: All that was hidden was named, and nothing else; and what is outside the
            library beside it has a free form at its joint.
        fine: Exact, or within a class of at most three that is said to be ambiguous.
        abstains: It names nothing.
        warns: It names nothing, says that a part of the gap stays unexplained, or
            that something outside the library acts.
        confident_wrong: It names a wrong effect, alone and without a warning.
        place: The first effect is at a right joint.
        within: What was hidden is among the effects and their rivals.
        size: Members of the largest class.
        wrong: Number of wrong names.
        errors: Relative error of each right effect's first number.
        covered: Whether each number of the right effects is within its interval.
        named: All of the library that was hidden was named, and nothing else.
        form: A free form is drawn at the joint of what is outside the library.
        remains: Most of what stays unexplained is at that joint.
    """

    exact: bool
    fine: bool
    abstains: bool
    warns: bool
    confident_wrong: bool
    place: bool
    within: bool
    size: int
    wrong: int
    errors: tuple[float, ...]
    covered: tuple[bool, ...]
    named: bool
    form: bool
    remains: bool


def judge(report: Row, truth: Row) -> Score:
    """Judge a report (the content of ``report.json``) against a truth."""
    effects = report["effects"]
    visible = [e for e in truth["effects"] if e["name"] not in truth["invisible"]]
    beside = _beside_outside(truth)
    unknown = truth["exclude"] or any(e.get("outside") for e in truth["effects"])
    hidden = [e for e in visible if not (beside and e.get("outside"))]
    joints = {e["target"] for e in visible if e.get("outside")}
    hits = [any(same(a, e) for a in effects) for e in hidden]
    extra = [a for a in effects if not any(same(a, e) for e in truth["effects"])]
    rivals = [
        hit or any(_small_class(a) and _rival(a, e) for a in effects)
        for hit, e in zip(hits, hidden, strict=True)
    ]
    abstains = not effects
    named = all(hits) and not extra
    unexplained = report.get("unexplained") or {}
    form, remains = (
        not joints or target in joints
        for target in (report.get("outside"), unexplained.get("target"))
    )
    if beside:
        exact = named and form
    elif unknown:
        quiet = _readable(truth) and report["verdict"] in _QUIET
        exact = abstains and (report["verdict"] == "unexplained" or quiet)
    elif not hidden:
        quiet = abstains and report["verdict"] in _QUIET
        exact = quiet or bool(effects and not extra)
    else:
        exact = named
    ambiguous = report["verdict"] == "ambiguous"
    in_class = ambiguous and all(rivals) and len(effects) == len(hidden) > 0
    share = unexplained.get("share") or 0.0
    warns = abstains or share > _TOLD_SHARE or bool(report.get("doubts"))
    right = [(a, e) for e in truth["effects"] for a in effects if same(a, e)]
    return Score(
        exact=exact,
        fine=exact or (in_class and (form if beside else not unknown)),
        abstains=abstains,
        warns=warns,
        confident_wrong=bool(extra) and not ambiguous and not warns,
        place=bool(effects) and any(_place(effects[0], e) for e in truth["effects"]),
        within=all(
            hit or any(_rival(a, e) for a in effects)
            for hit, e in zip(hits, hidden, strict=True)
        ),
        size=max((1 + len(a.get("rivals", ())) for a in effects), default=0),
        wrong=len(extra),
        errors=tuple(x for a, e in right if (x := _error(a, e)) is not None),
        covered=tuple(inside for a, e in right for inside in _covered(a, e)),
        named=named,
        form=form,
        remains=remains,
    )


def _beside_outside(truth: Row) -> bool:
    """Return whether some effects are of the library and others outside it."""
    return len({bool(e.get("outside")) for e in truth["effects"]}) == 2


def _readable(truth: Row) -> bool:
    """Return whether the log's reader alone can see and correct what was hidden."""
    return all(e["name"] == "repeated_frames" for e in truth["effects"])


def _small_class(answer: Row) -> bool:
    return 1 + len(answer.get("rivals", ())) <= _LARGEST_CLASS


def _rival(answer: Row, truth: Row) -> bool:
    return any(same(rival, truth) for rival in answer.get("rivals", ()))


def _place(answer: Row, truth: Row) -> bool:
    return same({**answer, "name": truth["name"]}, truth)


def _error(answer: Row, truth: Row) -> float | None:
    """Return the relative error of the first number, of a factor that of its change."""
    name, wanted = next(iter(truth["parameters"].items()), ("", 0.0))
    if name not in answer["parameters"]:
        return None
    away = wanted - 1.0 if name == "factor" else wanted
    return abs(answer["parameters"][name]["value"] - wanted) / abs(away)


def _covered(answer: Row, truth: Row) -> list[bool]:
    told = answer["parameters"]
    return [
        told[name]["low"] <= wanted <= told[name]["high"]
        for name, wanted in truth["parameters"].items()
        if name in told
    ]


@dataclass(frozen=True)
class Answered:
    """A case with its truth and our answer, and those of others where there are any."""

    truth: Row
    score: Score
    result: Row
    naive: Row | None = None
    sysid: Row | None = None


def table(rows: Sequence[Answered]) -> str:
    """Return all tables, in Markdown."""
    parts = [_groups(rows), _beside(rows), _details(rows), _sysid(rows)]
    return "\n\n".join(part for part in parts if part)


def _groups(rows: Sequence[Answered]) -> str:
    lines = [
        "| group | cases | exact [95 %] | or in a class of 3 | wrong names "
        "| seconds, median | seconds of CPU |",
        "|---|---|---|---|---|---|---|",
    ]
    for group in sorted({row.truth["group"] for row in rows}):
        inside = [row for row in rows if row.truth["group"] == group]
        cells = [group, str(len(inside))]
        cells += [share_of([row.score.exact for row in inside])]
        cells += [share_of([row.score.fine for row in inside])]
        cells += [str(sum(row.score.wrong for row in inside))]
        for clock in ("seconds", "cpu"):
            cells += [_middle([row.result[clock] for row in inside], "{:.0f}")]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _beside(rows: Sequence[Answered]) -> str:
    """Return the table against the greedy search, of the cases that both searched."""
    both = [row for row in rows if row.naive is not None]
    if not both:
        return ""
    lines = [
        "| searched by both | cases | exact | greedy: exact | wrong names | greedy's "
        "| seconds, median | greedy's | seconds of CPU | greedy's | times faster |",
        "|---" * 11 + "|",
    ]
    groups = sorted({row.truth["group"] for row in both})
    for group in (*groups, "all"):
        inside = [row for row in both if group in (row.truth["group"], "all")]
        cells = [group, str(len(inside)), str(sum(row.score.exact for row in inside))]
        cells += [str(sum(_naive_score(row).exact for row in inside))]
        cells += [str(sum(row.score.wrong for row in inside))]
        cells += [str(sum(_naive_score(row).wrong for row in inside))]
        for clock in ("seconds", "cpu"):
            for who in (
                [r.result for r in inside],
                [r.naive for r in inside if r.naive],
            ):
                cells += [_middle([one[clock] for one in who], "{:.0f}")]
        ratios = [r.naive["seconds"] / r.result["seconds"] for r in inside if r.naive]
        cells += [_middle(ratios, "{:.1f}")]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _naive_score(row: Answered) -> Score:
    """Judge the greedy baseline, which abstains by naming nothing."""
    effects = (row.naive or {}).get("effects")
    if effects is None:  # out of time
        return judge({"verdict": "failed", "effects": []}, row.truth)
    report = {"verdict": "named" if effects else "unexplained", "effects": effects}
    if not effects and not row.truth["effects"]:
        report["verdict"] = "no_gap"
    bare = [{**e, "parameters": {}, "rivals": []} for e in effects]
    return judge({**report, "effects": bare}, row.truth)


def _details(rows: Sequence[Answered]) -> str:
    def of(*groups: str) -> list[Answered]:
        return [row for row in rows if row.truth["group"] in groups]

    def rate(groups: Sequence[str], test: Callable[[Score], bool]) -> str:
        return share_of([test(row.score) for row in of(*groups)])

    def unknown(test: Callable[[Score], bool]) -> str:
        # The library has grown: some that were outside it are not any more.
        rows = of("outside", "outside_hard")
        lacks = [any(e.get("outside") for e in r.truth["effects"]) for r in rows]
        return share_of([test(r.score) for r, x in zip(rows, lacks, strict=True) if x])

    def wrong_left_out(distinct: bool) -> str:
        rows = [r for r in of("leave_out") if distinguishable(r.result) is distinct]
        return share_of([row.score.confident_wrong for row in rows])

    singles = of("single")
    hard = ("single_hard", "pair_hard", "triple_hard")
    named = ("single", "single_hard", "pair", "triple", "pair_hard", "triple_hard")
    errors = [error for row in singles for error in row.score.errors]
    within = [inside for row in of(*named) for inside in row.score.covered]
    sizes = [row.score.size for row in of("single_demo") if row.score.size]
    nothing = ("none", "none_hard", "none_demo")
    lines = ["| measure | value | wanted |", "|---|---|---|"]
    for severity, wanted in ((0.5, "85 %"), (1.0, "95 %"), (2.0, "95 %")):
        exact = [r.score.exact for r in singles if r.truth["severity"] == severity]
        lines.append(
            f"| singles named, {severity} x typical | {share_of(exact)} | {wanted} |"
        )
    facts = [
        ("single: right joint", rate(["single"], lambda s: s.place), "97 %"),
        ("single: error of the value, median", _middle(errors, "{:.1%}"), "10 %"),
        (
            "demo: hidden effect in the class",
            rate(["single_demo"], lambda s: s.within),
            "98 %",
        ),
        ("demo: size of the class, median", _middle(sizes, "{:.0f}"), "3"),
        (
            "demo: wrong and alone",
            rate(["single_demo"], lambda s: s.confident_wrong),
            "2 %",
        ),
        ("pairs exact", rate(["pair"], lambda s: s.exact), "92 %"),
        ("triples exact", rate(["triple"], lambda s: s.exact), "80 %"),
        ("four at once: exact", rate(["four"], lambda s: s.exact), "60 %"),
        ("hobby arm: singles exact", rate(["hobby_single"], lambda s: s.exact), "90 %"),
        ("hobby arm: pairs exact", rate(["hobby_pair"], lambda s: s.exact), "75 %"),
        ("late at random: exact", rate(["late"], lambda s: s.exact), "90 %"),
        ("hard, all sizes: exact", rate(hard, lambda s: s.exact), ""),
        ("false alarms without a gap", rate(nothing, lambda s: s.wrong > 0), "3 %"),
        ("outside the library: abstains", unknown(lambda s: s.abstains), ""),
        ("outside: abstains or warns", unknown(lambda s: s.warns), "90 %"),
        (
            "outside: wrong without a warning",
            unknown(lambda s: s.confident_wrong),
            "5 %",
        ),
        ("one beside one outside: named", rate(["beside"], lambda s: s.named), ""),
        (
            "one beside one outside: free form at its joint",
            rate(["beside"], lambda s: s.form),
            "",
        ),
        (
            "one beside one outside: what stays unexplained at its joint",
            rate(["beside"], lambda s: s.remains),
            "",
        ),
        (
            "one beside one outside: named, and free form at its joint",
            rate(["beside"], lambda s: s.exact),
            "80 %",
        ),
        ("uncommon effects: exact", rate(["uncommon"], lambda s: s.exact), "90 %"),
        (
            "one effect left out: abstains or warns",
            rate(["leave_out"], lambda s: s.warns),
            "90 %",
        ),
        (
            "one effect left out: wrong without a warning",
            rate(["leave_out"], lambda s: s.confident_wrong),
            "",
        ),
        (
            "one effect left out, not distinguishable: wrong without a warning",
            wrong_left_out(distinct=False),
            "",
        ),
        (
            "one effect left out, distinguishable: wrong without a warning",
            wrong_left_out(distinct=True),
            "5 %",
        ),
        ("intervals (90 %) that hold the value", share_of(within), "85-95 %"),
    ]
    lines += [f"| {what} | {value} | {wanted} |" for what, value, wanted in facts]
    return "\n".join(lines)


def _sysid(rows: Sequence[Answered]) -> str:
    """Held-out gap of our answer against mujoco.sysid's, as medians of ratios."""
    beside = [(row.result, row.sysid) for row in rows if row.sysid is not None]
    beside = [(r, s) for r, s in beside if r.get("left") is not None and s is not None]
    if not beside:
        return ""
    right = [r["left"] / s["oracle"] for r, s in beside if "oracle" in s]
    usual = [s["pace"] / r["left"] for r, s in beside if "pace" in s]
    times = [
        (r["seconds"], s["oracle_seconds"], s.get("pace_seconds"))
        for r, s in beside
        if "oracle_seconds" in s
    ]
    good = [ratio <= 1.05 for ratio in right]
    lines = [
        "| held-out gap, whole recordings | value | wanted |",
        "|---|---|---|",
        "| ours / mujoco.sysid's given the right effects, median | "
        f"{_middle(right, '{:.3f}')} | 1.05 |",
        f"| cases within 5 % of it | {share_of(good)} | |",
        "| mujoco.sysid's with the usual five / ours, median | "
        f"{_middle(usual, '{:.1f}')} | 3 |",
        "| seconds of ours, that finds out what is missing, median | "
        f"{_middle([ours for ours, _, _ in times], '{:.0f}')} | |",
        "| seconds of mujoco.sysid's, given what is missing | "
        f"{_middle([told for _, told, _ in times], '{:.0f}')} | |",
        "| seconds of mujoco.sysid's with the usual five | "
        f"{_middle([usual for _, _, usual in times if usual], '{:.0f}')} | |",
    ]
    return "\n".join(lines)


def share_of(tests: Sequence[bool]) -> str:
    """Return a share in words, with its Wilson interval."""
    if not tests:
        return "-"
    rate, low, high = wilson_interval(sum(tests), len(tests))
    return f"{sum(tests)}/{len(tests)} = {rate:.0%} [{low:.0%}, {high:.0%}]"


def _middle(values: Sequence[float], form: str) -> str:
    return form.format(median(values)) if values else "-"
