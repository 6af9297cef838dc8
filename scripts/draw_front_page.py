"""Draw docs/figures/front.png: a gap that is named, and policies that are compared.

uv run scripts/draw_front_page.py

The left side is what `find_gap` finds in docs/example, whose report it also writes to
docs/gallery/gap_report.html. The right side repeats docs/tables/methods.md, five seeds.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlco.gap import run_gap
from rlco.gap.diagnose.traces import Stretch
from rlco.reporting.plot_style import INK, METHOD_STYLES

DOCS = Path(__file__).parents[1] / "docs"
#: Success in stand_in, mean of five seeds and its interval of 95 % [%].
SUCCESS = {
    ("real_only", ""): (14, 8, 19),
    ("sft", ""): (47, 35, 58),
    ("rl_only", ""): (69, 62, 76),
    ("rl_co", ""): (72, 67, 77),
    ("sft", "\n300 sim"): (93, 90, 97),
}


def main() -> None:
    """Search the example, write its report, and draw."""
    finding = run_gap(DOCS / "example" / "arm.xml", DOCS / "example" / "logs")
    with tempfile.TemporaryDirectory() as folder:
        example = "model=docs/example/arm.xml data=docs/example/logs"
        command = f"rlco find_gap {example} out=gap_report"
        report = finding.write(Path(folder) / "gap_report", command=command)
        gallery = DOCS / "gallery"
        gallery.mkdir(exist_ok=True)
        shutil.copy(report, gallery / "gap_report.html")
    figure = Figure(figsize=(9, 3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    draw_gap(left, finding.figures.stretches[0])
    draw_success(right)
    figure.savefig(DOCS / "figures" / "front.png", dpi=160)


def draw_gap(axes: Axes, stretch: Stretch) -> None:
    """Draw one joint: measured, the model as it was, and corrected."""
    time = stretch.time - stretch.time[0]
    lines = [
        ("measured", stretch.measured, INK, "-"),
        ("model as it was", stretch.nominal, "#d55e00", "--"),
        ("model with a delay and a payload added", stretch.corrected, "#009e73", ":"),
    ]
    for label, values, colour, style in lines:
        axes.plot(time, np.degrees(values), style, color=colour, label=label)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{stretch.channel} [degrees]")
    axes.set_title("Where the simulator disagrees, and what it lacks")
    axes.set_ylim(-120, 60)  # room for the legend
    axes.legend(frameon=False, fontsize=8, loc="lower left")


def draw_success(axes: Axes) -> None:
    """Draw success of the methods in the second simulator."""
    for place, ((method, _), (mean, low, high)) in enumerate(SUCCESS.items()):
        colour, _ = METHOD_STYLES[method]
        error = [[mean - low], [high - mean]]
        axes.bar(place, mean, yerr=error, color=colour, capsize=3)
    labels = [method + data for method, data in SUCCESS]
    axes.set_xticks(range(len(SUCCESS)), labels, fontsize=8)
    axes.set_ylim(0, 100)
    axes.set_ylabel("success [%]")
    axes.set_title("push_cube in a second simulator")


if __name__ == "__main__":
    main()
