"""Five seeds of the quickstart with each kind of policy: success, and what it costs.

    uv run benchmarks/policy_kinds.py out=outputs/kinds

Each cell is one run of recipes/quickstart.py; within a seed all kinds have the same
demonstrations, rollout starts and evaluation episodes. Wanted of token and flow: the
Gaussian's success within 10 points, means over seeds, in at most twice its time.
Prints the table; started again it goes on where it was. For times that compare, run
nothing else beside it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rlco.reporting.statistics import mean_interval
from rlco.run import run_recipe
from rlco.runs.config import option
from rlco.runs.metrics import read_metrics

QUICKSTART = Path(__file__).parents[1] / "recipes" / "quickstart.py"
DOMAINS = ("sim", "stand_in")


@dataclass
class Config:
    """Options of policy_kinds.py."""

    out: str = option("outputs/kinds", "folder; a finished run in it is kept")
    kinds: list[str] = option(["gaussian", "token", "flow"], "kinds of policies")
    advantages: list[str] = option(["gae"], "ways to estimate advantages: gae, mc")
    seeds: int = option(5, "number of seeds", minimum=1)
    first_seed: int = option(
        10, "the first of them; settings were tried on seed 0", minimum=0
    )
    options: list[str] = option([], "further options of quickstart.py")


@dataclass(frozen=True)
class Cell:
    """One kind of policy with one way to estimate advantages, and its runs."""

    kind: str
    advantage: str
    folders: tuple[Path, ...]


def run_cells(config: Config) -> list[Cell]:
    """Run what is not finished yet, seed by seed; return the cells."""
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    names = [(k, a) for k in config.kinds for a in config.advantages]
    for seed in seeds:
        for kind, advantage in names:
            folder = folder_of(config, kind, advantage, seed)
            if (folder / "results.json").exists():
                continue
            start = f"resume={folder}" if folder.exists() else f"out={folder}"
            command = [sys.executable, str(QUICKSTART), start, f"seed={seed}"]
            command += [f"policy={kind}", f"advantage={advantage}", "film=false"]
            subprocess.run([*command, *config.options], check=True)
    return [
        Cell(kind, a, tuple(folder_of(config, kind, a, seed) for seed in seeds))
        for kind, a in names
    ]


def folder_of(config: Config, kind: str, advantage: str, seed: int) -> Path:
    """Return the run directory of one run."""
    return Path(config.out) / f"{kind}_{advantage}" / f"seed{seed}"


def results(folder: Path) -> dict[tuple[str, str], float]:
    """Return a run's success rates by method and domain, and its minutes."""
    content = json.loads((folder / "results.json").read_text())
    rates = {
        (row["method"], row["domain"]): row["successes"] / row["episodes"]
        for row in content["rows"]
    }
    return rates | {("minutes", ""): content["seconds"] / 60}


def a_rollout(folder: Path) -> tuple[float, float]:
    """Return a run's median seconds of collecting and of learning a rollout."""
    rows = read_metrics(folder / "stages" / "rl_co" / "timings.csv")
    collect, learn = (
        float(np.median([row[name] for row in rows])) for name in ("collect", "learn")
    )
    return collect, learn


def table(cells: list[Cell]) -> str:
    """Return the tables of success and of time, in Markdown."""
    found = {id(cell): [results(folder) for folder in cell.folders] for cell in cells}
    first = found[id(cells[0])]
    methods = [m for m, domain in first[0] if domain == "sim"]
    columns = [(method, domain) for method in methods for domain in DOMAINS]
    head = " | ".join(f"{method}, {domain}" for method, domain in columns)
    lines = [f"| policy | {head} |", "|---" * (len(columns) + 1) + "|"]
    for cell in cells:
        row = [f"{cell.kind}, {cell.advantage}"]
        for column in columns:
            values = [run[column] for run in found[id(cell)]]
            mean, low, high = mean_interval(values)
            text = f"{mean:.0%}"
            if len(values) > 1:
                text += f" [{max(low, 0):.0%}, {min(high, 1):.0%}]"
            if cell is not cells[0]:
                less = mean - float(np.mean([run[column] for run in first]))
                text += f" ({100 * less:+.0f})"
            row.append(text)
        lines.append("| " + " | ".join(row) + " |")
    lines += ["", "| policy | minutes | times the first | collect [s] | learn [s] |"]
    lines.append("|---|---|---|---|---|")
    for cell in cells:
        minutes = float(np.mean([run["minutes", ""] for run in found[id(cell)]]))
        base = float(np.mean([run["minutes", ""] for run in first]))
        collect, learn = np.mean([a_rollout(folder) for folder in cell.folders], axis=0)
        row = [f"{cell.kind}, {cell.advantage}", f"{minutes:.1f}"]
        row += [f"{minutes / base:.2f}", f"{collect:.2f}", f"{learn:.2f}"]
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def main(config: Config) -> None:
    """Run and print."""
    text = table(run_cells(config))
    (Path(config.out) / "table.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    run_recipe(main, Config)
