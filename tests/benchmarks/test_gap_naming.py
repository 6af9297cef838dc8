"""How answers are judged, and that a search never sees what was hidden."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gap_naming
import pytest
from gap_cases import plan
from gap_scoring import Answered, judge, table

Row = dict[str, Any]


def hidden(name: str, target: str | None = "joint2", value: float = 1.0) -> Row:
    parameters = {"frictionloss": value}
    return {"name": name, "target": target, "value": value, "parameters": parameters}


def truth(*effects: Row, **more: Any) -> Row:
    return {"effects": list(effects), "exclude": [], "invisible": [], **more}


def told(name: str, target: str | None = "joint2", value: float = 1.0) -> Row:
    number = {"value": value, "low": 0.9 * value, "high": 1.1 * value}
    parameters = {"frictionloss": number}
    return {"name": name, "target": target, "parameters": parameters, "rivals": []}


def report(verdict: str, *effects: Row, share: float = 0.0) -> Row:
    return {
        "verdict": verdict,
        "effects": list(effects),
        "unexplained": {"share": share},
    }


COULOMB, DAMPING = hidden("coulomb_friction"), hidden("viscous_damping", "joint1")


def test_a_right_name_at_the_wrong_joint_is_wrong() -> None:
    right = judge(report("named", told("coulomb_friction")), truth(COULOMB))
    wrong = judge(report("named", told("coulomb_friction", "joint3")), truth(COULOMB))
    assert (right.exact, right.place, right.wrong) == (True, True, 0)
    assert (wrong.exact, wrong.place, wrong.wrong) == (False, False, 1)
    assert wrong.confident_wrong


def test_a_pair_needs_both_and_no_third() -> None:
    both = truth(COULOMB, DAMPING)
    answers = [told("coulomb_friction"), told("viscous_damping", "joint1")]
    assert judge(report("named", *answers), both).exact
    assert not judge(report("named", *answers[:1]), both).exact
    assert not judge(report("named", *answers, told("backlash")), both).exact


@pytest.mark.parametrize(
    ("verdict", "rivals", "fine"),
    [("ambiguous", 2, True), ("ambiguous", 3, False), ("named", 2, False)],
)
def test_a_class_counts_up_to_three_and_where_it_is_said(
    verdict: str, rivals: int, fine: bool
) -> None:
    answer = told("backlash")
    others = [{"name": "stribeck_friction", "target": "joint2"}] * (rivals - 1)
    answer["rivals"] = [{"name": "coulomb_friction", "target": "joint2"}, *others]
    score = judge(report(verdict, answer), truth(COULOMB))
    assert (score.exact, score.fine, score.within) == (False, fine, True)
    assert score.size == 1 + rivals


def test_outside_the_library_only_silence_is_right() -> None:
    outside = truth({**COULOMB, "outside": True})
    assert judge(report("unexplained"), outside).exact
    assert not judge(report("no_gap"), outside).exact
    named = judge(report("named", told("backlash")), outside)
    assert (named.exact, named.warns, named.confident_wrong) == (False, False, True)
    warned = judge(report("named", told("backlash"), share=0.4), outside)
    assert (warned.exact, warned.warns, warned.confident_wrong) == (False, True, False)


def test_beside_one_outside_each_has_to_be_found() -> None:
    drift = {**hidden("slow_drift", "joint3"), "outside": True}
    both = truth(COULOMB, drift)
    found = report("named", told("coulomb_friction"), share=0.3)
    found["unexplained"]["target"] = "joint2"
    right = judge({**found, "outside": "joint3"}, both)
    assert (right.exact, right.named, right.form, right.remains) == (
        True,
        True,
        True,
        False,
    )
    elsewhere = judge({**found, "outside": "joint2"}, both)
    assert (elsewhere.exact, elsewhere.named, elsewhere.form) == (False, True, False)
    silent = judge({**report("unexplained"), "outside": "joint3"}, both)
    assert (silent.exact, silent.named, silent.form) == (False, False, True)
    more = report("named", told("coulomb_friction"), told("backlash"))
    extra = judge({**more, "outside": "joint3"}, both)
    assert (extra.exact, extra.named, extra.wrong) == (False, False, 1)
    # What does not show need not be reported.
    faint = truth(COULOMB, drift, invisible=["slow_drift"])
    assert judge(found, faint).exact


def test_a_wrong_name_that_no_recording_refutes_is_counted_apart() -> None:
    # Three answers of ten that are wrong without a warning; two can be told, by
    # 10 + ln(900) = 16.8.
    left_out = truth(COULOMB, exclude=["coulomb_friction"], group="leave_out")
    wrong, silent = report("named", told("backlash")), report("unexplained")
    answers = [(wrong, 16.7), (wrong, 16.9), (wrong, 900.0)] + 7 * [(silent, 900.0)]
    rows = [
        Answered(
            left_out,
            judge(one, left_out),
            {**one, "evidence": x, "numbers": 900, "seconds": 1.0, "cpu": 1.0},
        )
        for one, x in answers
    ]
    text = table(rows)
    assert "| one effect left out: wrong without a warning | 3/10" in text
    assert "not distinguishable: wrong without a warning | 1/1 " in text
    assert "out, distinguishable: wrong without a warning | 2/9 " in text


def test_what_does_not_show_need_not_be_named_and_may_be() -> None:
    faint = truth(COULOMB, invisible=["coulomb_friction"])
    assert judge(report("no_gap"), faint).exact
    assert judge(report("named", told("coulomb_friction")), faint).exact
    assert not judge(report("named", told("backlash")), faint).exact


def test_value_error_and_interval() -> None:
    score = judge(report("named", told("coulomb_friction", value=1.2)), truth(COULOMB))
    assert score.errors == (pytest.approx(0.2),)
    assert score.covered == (False,)  # from 1.08 to 1.32


def test_any_first_part_holds_all_groups() -> None:
    cases = gap_naming.in_order(plan(0))
    groups = {case.group for case in cases}
    assert {case.group for case in cases[:40]} == groups
    third = cases[: len(cases) // 3]
    assert sum(case.group == "single" for case in third) == pytest.approx(21, abs=1)


def test_a_search_gets_model_and_data_and_no_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = tmp_path / "case"
    (case / "data").mkdir(parents=True)
    (case / "model.xml").write_text("<mujoco/>")
    (case / "truth.json").write_text(json.dumps(truth(COULOMB, exclude=["armature"])))
    seen: dict[str, Any] = {}

    def look(command: list[str]) -> Row:
        seen["files"] = sorted(p.name for p in Path(command[2]).iterdir())
        seen["exclude"] = command[3]
        return {"verdict": "no_gap", "effects": []}

    monkeypatch.setattr(gap_naming, "_run", look)
    assert gap_naming.search(case)["name"] == "case"
    assert seen == {"files": ["data", "model.xml"], "exclude": "exclude=armature"}


def test_a_finished_case_is_not_searched_again(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "abc"]
    for folder in folders:
        folder.mkdir()
        (folder / "truth.json").write_text(json.dumps(truth(COULOMB)))
    asked: list[str] = []

    def work(folder: Path) -> Row:
        asked.append(folder.name)
        return {"name": folder.name, **report("no_gap"), "seconds": 1.0}

    path = tmp_path / "rows.jsonl"
    gap_naming.fill(gap_naming.Book(path), iter(folders[:2]), work, gap_naming.Config())
    gap_naming.fill(gap_naming.Book(path), iter(folders), work, gap_naming.Config())
    assert asked == ["a", "b", "c"]


def test_a_broken_search_is_a_row_and_counts_as_wrong(tmp_path: Path) -> None:
    import sys

    row = gap_naming._run([sys.executable, "-c", "raise ValueError('broken')"])
    assert row["failed"] == "ValueError: broken"
    book = gap_naming.Book(tmp_path / "rows.jsonl")
    book.add({"name": "a", **row})
    assert gap_naming.Book(tmp_path / "rows.jsonl").rows["a"]["failed"]
