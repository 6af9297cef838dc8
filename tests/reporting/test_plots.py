"""Figures: what is drawn is what was measured, and is called what it is."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from rlco.reporting.image_plots import episode_strip, same_scene
from rlco.reporting.plot_style import (
    METHOD_STYLES,
    READING,
    domain_titles,
    new_figure,
    styles,
)
from rlco.reporting.plots import (
    Curve,
    anchor_strength,
    forgetting,
    learning_curves,
    save_figure,
    success_bars,
)
from rlco.reporting.statistics import ResultRow, mean_interval, wilson_interval


def row(method: str, domain: str, successes: int, seed: int = 0) -> ResultRow:
    return {
        "method": method,
        "task": "push_cube",
        "policy": "gaussian",
        "domain": domain,
        "variation": None,
        "seed": seed,
        "episodes": 20,
        "successes": successes,
    }


def bars(figure: Figure) -> list[float]:
    return [patch.get_height() for patch in figure.axes[0].patches]


def interval_lines(figure: Figure) -> list[tuple[float, float]]:
    return [
        (segment[0][1], segment[1][1])
        for lines in figure.axes[0].collections
        for segment in lines.get_segments()
    ]


def texts(figure: Figure) -> str:
    figure.canvas.draw()
    every = (
        item.get_text() for item in figure.findobj(lambda a: hasattr(a, "get_text"))
    )
    return " | ".join(every)


def test_bars_show_rate_and_wilson_interval_of_one_seed() -> None:
    figure = success_bars([row("rl_co", "stand_in", 17), row("sft", "stand_in", 5)])
    # The comparison's order, not the order given.
    assert bars(figure) == [0.25, 0.85]
    expected = [wilson_interval(5, 20)[1:], wilson_interval(17, 20)[1:]]
    assert np.allclose(interval_lines(figure), expected)
    assert "n = 20 episodes per bar; black line: 95 % Wilson interval." in texts(figure)


def test_bars_show_mean_interval_and_every_seed_of_several() -> None:
    figure = success_bars(
        [row("sft", "sim", k, seed) for seed, k in enumerate((8, 12))]
    )
    assert bars(figure) == [0.5]
    low, high = mean_interval([0.4, 0.6])[1:]
    assert interval_lines(figure) == [(max(low, 0), min(high, 1))]
    (dots,) = figure.axes[0].lines
    assert list(dots.get_ydata()) == [0.4, 0.6]
    assert "Mean of 2 seeds" in texts(figure)


def test_missing_cell_leaves_a_gap_and_keeps_the_legend() -> None:
    figure = success_bars([row("sft", "sim", 4), row("rl_co", "stand_in", 6)])
    centres = [p.get_x() + p.get_width() / 2 for p in figure.axes[0].patches]
    assert centres == pytest.approx([0 - 0.21, 1 + 0.21])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["sft", "rl_co"]


def curve(method: str, domain: str, *seeds: list[float]) -> Curve:
    return Curve(method, domain, [0, 1000, 2000], seeds, episodes=50)


def test_curve_shows_mean_and_the_seed_that_ends_lowest() -> None:
    up, down = [0.2, 0.5, 0.8], [0.4, 0.7, 0.6]
    (axes,) = learning_curves([curve("rl_co", "stand_in", up, down)]).axes
    mean, worst = axes.lines
    assert np.allclose(mean.get_ydata(), [0.3, 0.6, 0.7])
    assert list(worst.get_ydata()) == down
    assert worst.get_linestyle() == ":"


def test_curve_of_one_seed_has_a_wilson_band() -> None:
    (axes,) = learning_curves([curve("rl_co", "sim", [0.2, 0.5, 0.8])]).axes
    (band,) = axes.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.min() == pytest.approx(wilson_interval(10, 50).low)
    assert heights.max() == pytest.approx(wilson_interval(40, 50).high)


def test_captions_say_how_many_seeds_where_not_all_have_as_many() -> None:
    rates = [0.2, 0.5, 0.8]
    several = curve("rl_co", "sim", *[rates] * 5)
    curves = [several, curve("rl_only", "sim", *[rates] * 3)]
    assert "mean of 3 to 5 seeds;" in learning_curves(curves).get_label()
    text = learning_curves([several, curve("sft", "sim", rates)]).get_label()
    assert "mean of 1 to 5 seeds; band: 95 % t interval of that mean, of one" in text
    rows = [row("sft", "sim", 4), row("sft", "sim", 6, seed=1), row("rl", "sim", 5)]
    assert success_bars(rows).get_label().startswith("Mean of 1 to 2 seeds (dots)")


def test_curve_with_other_frames_than_rates_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(1, 2\), expected \(seeds, 3\)"):
        learning_curves([curve("rl_co", "sim", [0.2, 0.5])])


def test_an_anchor_that_is_lost_in_noise_reaches_the_top() -> None:
    nan, inf = float("nan"), float("inf")
    strength = [[0.5, nan], [0.4, 0.3], [0.7, inf]]
    cosine = [[0.1, nan], [0.0, nan], [0.2, nan]]
    size, angle = anchor_strength([10, 20], strength, cosine).axes
    (first, second) = size.collections[0].get_segments()
    assert [tuple(end) for end in first] == [(10, 0.4), (10, 0.7)]
    assert second[1][1] > size.get_ylim()[1]
    # What is not known is not drawn.
    assert len(angle.collections[0].get_segments()) == 1
    assert not size.texts
    assert not angle.texts


def test_a_cosine_that_is_never_known_says_so() -> None:
    nan = float("nan")
    figure = anchor_strength([10], [[0.5], [0.4], [0.7]], [[nan], [nan], [nan]])
    size, angle = figure.axes
    assert not size.texts
    assert [text.get_text() for text in angle.texts] == [
        "lost in the noise of RL's gradient"
    ]


def test_forgetting_is_shown_beside_success_in_the_robots_domain() -> None:
    steps = [0.0, 100.0]
    figure = forgetting(
        {"rl_only": (steps, [0.0, 0.3])}, {"rl_only": (steps, [0.8, 0.4])}, "stand_in"
    )
    drift, success = figure.axes
    assert list(drift.lines[0].get_ydata()) == [0.0, 0.3]
    assert list(success.lines[0].get_ydata()) == [0.8, 0.4]
    assert "(a second simulator, not a robot)" in texts(figure)


def test_no_figure_lets_a_reader_think_that_a_robot_moved() -> None:
    frame = np.zeros((4, 6, 3), np.uint8)
    for figure in (
        success_bars([row("sft", "stand_in", 3)]),
        learning_curves([curve("sft", "stand_in", [0.1, 0.2, 0.3])]),
        episode_strip([frame, frame], [0.0, 0.5], "stand_in"),
    ):
        assert "(a second simulator, not a robot)" in texts(figure)


def test_curves_name_their_group_and_keep_how_to_read_them(tmp_path: Path) -> None:
    figure = learning_curves([curve("sft", "sim", [0.1, 0.2, 0.3])], group="task x")
    save_figure(figure, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.text["Title"] == "Success while learning, task x"
        assert image.text["Comment"] == READING["Success while learning"]


def test_titles_of_three_panels_do_not_touch() -> None:
    domains = ["sim", "stand_in", "locked"]
    figure, panels = new_figure("Three", 3, height=3.9)
    domain_titles(panels, domains)
    figure.canvas.draw()
    boxes = [axes.title.get_window_extent() for axes in panels]
    for left, right in itertools.pairwise(boxes):
        assert left.x1 < right.x0


def test_methods_look_different() -> None:
    looks = styles([*METHOD_STYLES, "mine", "yours"])
    assert len({colour for colour, _ in looks.values()}) == len(looks)
    assert len({marker for _, marker in looks.values()}) == len(looks)


def test_methods_of_other_names_look_different() -> None:
    looks = styles(["sft", *(f"beta {beta}" for beta in range(6))])
    assert len({colour for colour, _ in looks.values()}) == 7
    assert len({marker for _, marker in looks.values()}) >= 6
    many = styles([f"method {number}" for number in range(30)])
    assert len(set(many.values())) == 30


def test_saved_figure_carries_title_and_how_to_read_it(tmp_path: Path) -> None:
    frames = [0.0, 100.0]
    save_figure(
        forgetting({"rl_co": (frames, [0, 0.2])}, {}, "sim"), tmp_path / "new" / "a.png"
    )
    with Image.open(tmp_path / "new" / "a.png") as image:
        assert image.width == 1440
        assert image.text["Title"] == "Forgetting the demonstrations"
        assert image.text["Comment"] == READING["Forgetting the demonstrations"]
        assert image.text["Description"].startswith("Drift of the most likely actions")


def test_every_figure_of_rlco_says_how_to_read_it() -> None:
    frame = np.zeros((4, 6, 3), np.uint8)
    figures = (
        success_bars([row("sft", "sim", 3)]),
        learning_curves([curve("sft", "sim", [0.1, 0.2, 0.3])]),
        anchor_strength([0, 1], [[1, 1]] * 3, [[0, 0]] * 3),
        forgetting({"sft": ([0, 1], [1, 1])}, {"sft": ([0, 1], [1, 1])}, "sim"),
        same_scene({"agentview": {"sim": frame}}),
        episode_strip([frame], [0.0], "sim"),
    )
    assert [figure.get_suptitle() for figure in figures] == list(READING)


@pytest.mark.parametrize("name", [r"a$\frac$", "$x$", "cost in $"])
def test_names_are_no_formulas(tmp_path: Path, name: str) -> None:
    rows = [row("sft", name, 5), row(name, name, 5), row(name, "sim", 5)]
    curve = Curve(name, name, [0, 100], [[0.2, 0.5]], episodes=50)
    for figure in (success_bars(rows), learning_curves([curve])):
        save_figure(figure, tmp_path / "figure.png")
        assert name in texts(figure).replace("\n", " ")
