"""Tables of methods over seeds, by hand-worked numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rlco.errors import DataError
from rlco.reporting.experiments.comparison import (
    comparison_table,
    cost_table,
    overview_table,
    prediction_table,
)
from rlco.reporting.experiments.drift import drift_table, drifts_of
from rlco.reporting.experiments.entries import Entry, State, curves_of
from rlco.reporting.experiments.group_means import mean_table
from rlco.reporting.experiments.success_over import success_over
from rlco.reporting.plots import learning_curves
from rlco.runs.compare.experiment import Prediction, Published


def row(successes: int, domain: str = "sim", **more: Any) -> dict[str, Any]:
    return {"method": "m", "domain": domain, "episodes": 10} | {
        "successes": successes,
        **more,
    }


def entries(
    label: str, counts: list[int | None], state: State = "done", group: str = ""
) -> list[Entry]:
    """Return one entry a seed; None is a seed without a result.

    A group "task x, kind y" has these values.
    """
    values = dict(part.split() for part in group.split(", ") if " " in part)
    return [
        Entry(label, group, seed, "missing", values=values)
        if count is None
        else Entry(label, group, seed, state, (row(count),), values=values)
        for seed, count in enumerate(counts)
    ]


def lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("| ")]


def test_a_mean_has_students_interval_and_stands_beside_the_worst_seed() -> None:
    # t[1] = 12.706, s = sqrt(0.02): half-width 12.706 * 0.1 = 1.27, cut at 0 and 1.
    found = lines(comparison_table(entries("sft", [3, 5])))
    assert found == [
        "| method | sim | worst seed | seeds |",
        "| sft | 40% [0%, 100%] | 30% | 2 |",
    ]


def test_differences_are_paired_by_seed_and_need_both() -> None:
    both = [*entries("a", [9, 7, None, 5]), *entries("b", [5, 4, 8, None])]
    found = lines(comparison_table(both, [("a", "b")]))
    # Gains of 0.4 and 0.3: 0.35 +- 12.706 * 0.05
    assert found[-1] == "| a - b | +35.0 [-28.5, +98.5] | 2 |"
    assert found[1] == "| a | 70% [20%, 100%] | 50% | 3 of 4: 1 missing |"


def test_what_was_solved_and_lost_stands_beside_the_end() -> None:
    kept = row(2, outcomes=[1, 1] + 8 * [0], ever=[1, 1, 1, 1, 1] + 5 * [0])
    found = lines(comparison_table([Entry("a", "", 0, "done", (kept,))]))
    assert found == [
        "| method | sim | worst seed | at some time | lost again | seeds |",
        "| a | 20% | 20% | 50% | 30% | 1 |",
    ]


def test_each_group_has_its_table_and_domains_their_columns() -> None:
    rows = (row(1), row(2, "stand_in"), row(3, "stand_in", variation="camera"))
    text = comparison_table(
        [Entry("a", "gap yaw0", 0, "done", rows), *entries("a", [4], group="gap yaw8")]
    )
    assert text.startswith("## gap yaw0\n\n| method | sim | worst seed | stand_in |")
    assert "| a | 10% | 10% | 20% | 20% | 30% | 30% | 1 |" in text
    assert "## gap yaw8\n\n| method | sim | worst seed | seeds |" in text
    assert "| a | 40% | 40% | 1 |" in text


def test_older_results_are_marked_and_failures_counted() -> None:
    text = comparison_table(
        [*entries("a", [4], "older"), Entry("a", "", 1, "failed"), *entries("b", [1])]
    )
    assert "| a \\* | 40% | 40% | 1 of 2: 1 failed |" in text
    assert "| b | 10% | 10% | 1 |" in text
    assert text.endswith("\\* with results of another version of the code\n")


def test_two_results_in_one_domain_are_refused() -> None:
    twice = Entry("a", "", 0, "done", (row(1), row(2)))
    with pytest.raises(DataError, match="several results in 'sim'"):
        comparison_table([twice])


def test_curves_are_of_the_seeds_that_were_evaluated_alike() -> None:
    def seed(number: int, frames: list[float]) -> Entry:
        curve = tuple(
            {"frames": f, "success_sim": number / 10, "success_rollout": 1.0}
            for f in frames
        )
        return Entry("rl", "", number, "done", (row(1),), curve)

    runs = [seed(0, [0, 8]), seed(1, [0, 8]), seed(2, [0, 9])]
    (curve,) = curves_of([*runs, *entries("sft", [3, 4, 5])])
    assert (curve.method, curve.domain, curve.episodes) == ("rl", "sim", 10)
    assert curve.frames == [0, 8]
    assert curve.success == [[0.0, 0.0], [0.1, 0.1]]
    assert curves_of(runs, 64)[0].episodes == 64


def test_costs_are_means_over_the_jobs_that_there_are() -> None:
    runs = [
        Entry("rl", "", seed, "done", (row(1),), minutes=minutes)
        for seed, minutes in enumerate([1.0, 2.0])
    ]
    text = cost_table([*runs, Entry("rl", "", 2, "missing"), *entries("sft", [None])])
    assert lines(text)[1:] == ["| rl | 1.5 |", "| sft | missing |"]


def test_what_it_cost_has_a_line_for_each_group() -> None:
    given = [
        Entry(label, group, 0, "done", (row(1),), minutes=minutes)
        for label, group, minutes in (("a", "x", 1.0), ("a", "y", 3.0), ("b", "y", 5.0))
    ]
    assert lines(cost_table(given)) == [
        "| minutes of a processor, a job | a | b |",
        "| x | 1.0 | missing |",
        "| y | 3.0 | 5.0 |",
        "| mean | 2.0 | 5.0 |",
    ]


def test_an_overview_has_a_line_for_each_group_and_domain() -> None:
    given = [*entries("a", [9, 7], group="near"), *entries("b", [5, 4], group="near")]
    given += entries("a", [2, 2], group="far")
    assert lines(overview_table(given, [("a", "b")])) == [
        "| success in | a | b | a - b |",
        "| near, sim | 80% | 45% | +35.0 [-28.5, +98.5] |",
        "| far, sim | 20% | - | - |",
    ]


def test_a_prediction_counts_the_seeds_that_all_three_methods_have() -> None:
    # Gains of the anchor of 0.1, 0.3 and 0.6 where sim_only solves 0.9, 0.5 and 0.1.
    given = []
    for group, (zero_shot, anchored) in {
        "a": (9, 6),
        "b": (5, 8),
        "c": (1, 11),
    }.items():
        given += entries("sim_only", [zero_shot, zero_shot], group=group)
        given += entries("beta 1", [anchored, anchored], group=group)
        given += entries("beta 0", [5, None], group=group)
    prediction = Prediction(("beta 1", "beta 0"), "sim_only", "sim")
    found = lines(prediction_table(given, [prediction]))
    assert found[1].startswith("| beta 1 - beta 0 against sim_only, sim | -1.00 [-1.00")
    assert found[1].endswith("| 3, 3 in all |")
    assert "| missing |" in prediction_table(given[:6], [prediction])
    assert prediction_table(given, []) == ""


def test_a_mean_over_groups_counts_each_alike() -> None:
    # Gains of 0.1 and 0.3, mean 0.2; of 0.4, 0.5 and 0.6, mean 0.5. Variances of the
    # means 0.01 and 1/300; 1 and 2 degrees of freedom, 1.68 of both together; t = 5.18.
    both = [
        *entries("a", [5, 7], group="kind k, task x"),
        *entries("b", [4, 4], group="kind k, task x"),
        *entries("a", [8, 9, 9], group="kind k, task y"),
        *entries("b", [4, 4, 3], group="kind k, task y"),
        *entries("a", [1], group="kind l, task x"),
    ]
    reported = Published("a paper", {"kind": "k"}, {"b": 0.4})
    found = lines(mean_table(both, [("a", "b"), ("b", "c")], ["task"], [reported]))
    assert found[0] == "| mean over task, in | a | b | a - b | b - c | tables |"
    # a: means 0.6 and 26/30, of variances 0.01 and 1/900; 1.23 degrees of freedom, for
    # which t = 8.2; half-width 8.2 * sqrt(0.0111) / 2 = 0.43.
    assert found[1].startswith("| kind k, sim | 73% [30%, 100%] | 38% [")
    assert found[1].endswith("| +35.0 [+5.1, +64.9] | missing | 2 |")
    assert found[2] == "| *a paper* |  | *40%* |  |  |  |"
    assert found[3] == "| kind l, sim | 10% | missing | missing | missing | 1 |"


def test_what_others_reported_stands_below_the_group_that_it_belongs_beside() -> None:
    given = [*entries("a", [5], group="task x"), *entries("a", [5], group="task y")]
    reported = Published("a paper", {"task": "x"}, {"a": 0.25})
    assert lines(overview_table(given, [("a", "b")], [reported]))[1:] == [
        "| task x, sim | 50% | - |",
        "| *a paper* | *25%* |  |",
        "| task y, sim | 50% | - |",
    ]


def drifted(label: str, seed: int, *drift: float) -> Entry:
    curve = tuple(
        {"frames": 8.0 * step, "success_sim": 0.5, "drift_heldout": value}
        for step, value in enumerate(drift)
    )
    return Entry(label, "", seed, "done", (row(5),), curve)


def test_drift_at_the_end_is_compared_by_seed() -> None:
    runs = [drifted("rl", 0, 0.0, 0.4), drifted("rl", 1, 0.0, 0.2)]
    runs += [drifted("co", 0, 0.0, 0.1), drifted("co", 2, 0.0, 0.3)]
    found = lines(
        drift_table([*runs, *entries("sft", [3])], [("rl", "co"), ("co", "sft")])
    )
    # t[1] = 12.706, of two that differ by 0.2: half-width 1.2706.
    assert found == [
        "| drift at the end | rl | co | rl - co |",
        "| held-out demonstrations | 0.300 [-0.971, 1.571] | 0.200 [-1.071, 1.471] | "
        "+0.300 |",
    ]
    assert drift_table(entries("sft", [3]), []) == ""


def test_drift_is_drawn_beside_success() -> None:
    runs = [drifted("rl", seed, 0.0, 0.2 + 0.2 * seed) for seed in range(2)]
    (*_, panel) = learning_curves(curves_of(runs), drifts_of(runs)).axes
    assert panel.get_title() == "drift, held out"
    assert panel.lines[0].get_ydata() == pytest.approx([0.0, 0.3])


def test_success_is_drawn_over_a_variable_in_a_figure_for_each_of_the_others() -> None:
    given = [
        *entries("a", [2, 4], group="kind k, demos 5"),
        *entries("a", [8, 8], group="kind k, demos 20"),
        *entries("b", [1], group="kind k, demos 20"),
        *entries("a", [9], group="kind l, demos 5"),
    ]
    found = success_over(given, "demos")
    assert list(found) == ["kind k", "kind l"]
    (axes,) = found["kind k"].axes
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["5", "20"]
    (several, one) = axes.lines
    assert several.get_ydata() == pytest.approx([0.3, 0.8])
    assert one.get_ydata() == pytest.approx([0.1])
    (left, right) = axes.get_xlim()
    for line in axes.lines:
        assert left < min(line.get_xdata()) <= max(line.get_xdata()) < right
        assert not line.get_clip_on()  # at 0 % half a marker would be cut off
    assert found["kind k"].get_label().startswith("Mean of 1 to 2 seeds")
    assert found["kind l"].get_label() == "One seed, so without intervals."


def test_a_method_that_always_has_one_of_the_values_is_a_dashed_line() -> None:
    given = [
        *entries("a", [2, 4], group="demos 5"),
        *entries("a", [8, 8], group="demos 20"),
    ]
    given += [
        replace(entry, label="a with 20", always={"demos": 20})
        for group in ("demos 5", "demos 20")
        for entry in entries("", [8, 8], group=group)
    ]
    (axes,) = success_over(given, "demos")[""].axes
    (several, level) = axes.lines
    assert several.get_xdata() == pytest.approx([0, 1])  # in the middle, as if alone
    assert level.get_linestyle() == "--"
    assert level.get_ydata() == pytest.approx([0.8, 0.8])


def test_methods_stand_in_the_order_of_the_file_whatever_the_first_group_has() -> None:
    second = [replace(entry, line=1) for entry in entries("b", [5], group="task x")]
    both = [*second, *entries("a", [7], group="task y")]
    both += [replace(entry, line=1) for entry in entries("b", [6], group="task y")]
    head, first, last = lines(overview_table(both, []))
    assert head == "| success in | a | b |"
    assert first == "| task x, sim | - | 50% |"
    assert last == "| task y, sim | 70% | 60% |"


def test_a_group_lists_no_difference_of_a_method_that_it_has_not() -> None:
    one = entries("a", [5, 7], group="task x")
    text = comparison_table([*one, *entries("b", [1], group="task y")], [("a", "b")])
    assert "a - b" not in text
