"""Five seeds of real_only, sft, rl_only and rl_co, in both domains.

    uv run benchmarks/compare_methods.py out=outputs/compare

Each seed is one run of recipes/quickstart.py with all four methods: other
demonstrations, other networks, other rollouts, other evaluation episodes. Prints the
table, means over seeds with Student's t intervals, and draws success in both domains
over the length of RL. Started again it goes on where it was.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rlco.reporting.plots import Curve, learning_curves, save_figure
from rlco.reporting.statistics import mean_interval
from rlco.run import run_recipe
from rlco.runs.config import option
from rlco.runs.metrics import read_metrics

QUICKSTART = Path(__file__).parents[1] / "recipes" / "quickstart.py"
METHODS = ("real_only", "sft", "rl_only", "rl_co")
DOMAINS = ("sim", "stand_in")


@dataclass
class Config:
    """Options of compare_methods.py."""

    out: str = option("outputs/compare", "folder; a finished seed in it is kept")
    seeds: int = option(5, "number of seeds", minimum=2)
    first_seed: int = option(
        10, "the first of them; settings were tried on 0, 5, 8, 100 and 101", minimum=0
    )
    options: list[str] = option([], "further options of quickstart.py")


def run_seeds(config: Config) -> list[Path]:
    """Run what is not finished yet; return the run directories."""
    folders = []
    for seed in range(config.first_seed, config.first_seed + config.seeds):
        folder = Path(config.out) / f"seed{seed}"
        folders.append(folder)
        if (folder / "results.json").exists():
            continue
        start = f"resume={folder}" if folder.exists() else f"out={folder}"
        options = [f"seed={seed}", f"methods=[{','.join(METHODS)}]", "film=false"]
        options.append("eval_every=10")
        command = [sys.executable, str(QUICKSTART), start, *options, *config.options]
        subprocess.run(command, check=True)
    return folders


def table(folders: list[Path]) -> str:
    """Return the table of means over seeds, in Markdown."""
    rates: dict[tuple[str, str], list[float]] = {}
    for folder in folders:
        for row in json.loads((folder / "results.json").read_text())["rows"]:
            cell = rates.setdefault((row["method"], row["domain"]), [])
            cell.append(row["successes"] / row["episodes"])
    lines = [
        "| method | sim | sim, worst seed | stand_in | stand_in, worst seed |",
        "|---|---|---|---|---|",
    ]
    for method in METHODS:
        cells = [method]
        for domain in DOMAINS:
            values = rates[method, domain]
            mean, low, high = mean_interval(values)
            interval = f"[{max(low, 0):.0%}, {min(high, 1):.0%}]"
            cells += [f"{mean:.0%} {interval}", f"{min(values):.0%}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def curves(folders: list[Path]) -> list[Curve]:
    """Return success over the length of RL, all seeds, for each method and domain."""
    found = []
    for method in ("rl_only", "rl_co"):
        tables = [read_metrics(f / "stages" / method / "metrics.csv") for f in folders]
        for domain in DOMAINS:
            name = f"success_{domain}"
            points = [[row for row in rows if name in row] for rows in tables]
            frames = [row["frames"] for row in points[0]]
            success = [[row[name] for row in rows] for rows in points]
            found.append(Curve(method, domain, frames, success, 64))
    return found


def main(config: Config) -> None:
    """Run, print and draw."""
    folders = run_seeds(config)
    text = table(folders)
    (Path(config.out) / "table.md").write_text(text + "\n")
    save_figure(learning_curves(curves(folders)), Path(config.out) / "curves.png")
    print(text)


if __name__ == "__main__":
    run_recipe(main, Config)
