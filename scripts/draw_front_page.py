"""Draw docs/figures/front.png: a gap that is named, and policies that are compared.

uv run scripts/draw_front_page.py

The left side is what `find_gap` finds in docs/example, whose report it also writes to
docs/gallery/gap_report.html. The right side is of the cells of docs/tables/methods.md,
five seeds.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlco.gap import run_gap
from rlco.gap.diagnose.traces import Stretch
from rlco.reporting.plot_style import INK, METHOD_STYLES
from rlco.reporting.statistics import Interval, rate_interval

DOCS = Path(__file__).parents[1] / "docs"
CELLS = Path(__file__).parents[1] / "benchmarks" / "cells" / "push_cube"
#: Bars: the job whose cells tell of a method, the method, what else its label says.
BARS = (
    ("quickstart", "real_only", ""),
    ("quickstart", "sft", ""),
    ("rl_only", "rl_only", ""),
    ("quickstart", "rl_co", ""),
    ("sft_300", "sft", "\n300 sim"),
)


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


def success(job: str, method: str) -> Interval:
    """Return the mean over seeds in stand_in, with its interval of 95 %."""
    rows = [
        row
        for path in CELLS.glob(f"{job}_seed*.json")
        for row in json.loads(path.read_text())["rows"]
        if (row["method"], row["domain"]) == (method, "stand_in")
    ]
    return rate_interval(rows)


def draw_success(axes: Axes) -> None:
    """Draw success of the methods in the second simulator, in per cent."""
    for place, (job, method, _) in enumerate(BARS):
        mean, low, high = (100 * value for value in success(job, method))
        colour, _ = METHOD_STYLES[method]
        error = [[mean - low], [high - mean]]
        axes.bar(place, mean, yerr=error, color=colour, capsize=3)
    labels = [method + data for _, method, data in BARS]
    axes.set_xticks(range(len(BARS)), labels, fontsize=8)
    axes.set_ylim(0, 100)
    axes.set_ylabel("success [%]")
    axes.set_title("push_cube in a second simulator")


if __name__ == "__main__":
    main()
