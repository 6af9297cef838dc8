"""Two evaluations of the same initial states, compared in pairs.

Either may be a results.json of rlco, or an eval_info.json of LeRobot, whose own tables
have no intervals and no pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, cast

from rlco.errors import DataError, RlcoError
from rlco.files import Fields, read_json
from rlco.reporting.differences import Column, columns
from rlco.reporting.statistics import (
    Interval,
    ResultRow,
    check_paired,
    paired_difference,
    paired_over_seeds,
)
from rlco.runs.results_file import read_results

OURS, LEROBOT = "results.json", "eval_info.json"
#: The domain of LeRobot's rows: it knows none.
ONE_DOMAIN = "lerobot-eval"


@dataclass(frozen=True)
class Evaluation:
    """What one file tells.

    Attributes:
        path: The file.
        rows: One per method, environment and seed.
        states: What draws the initial states of each episode, by task; empty where the
            file does not tell.
    """

    path: Path
    rows: list[ResultRow]
    states: dict[str, list[int]] = field(default_factory=dict)

    @property
    def methods(self) -> list[str]:
        """The methods of its rows, in their order."""
        return list(dict.fromkeys(row["method"] for row in self.rows))

    def of(self, method: str | None, option: str) -> list[ResultRow]:
        """Return the rows of one method; None: of its only one.

        Raises:
            RlcoError: There is no such method, or several and none was named.
        """
        known = self.methods
        if not known:
            raise RlcoError(f"{self.path} has no rows; evaluate a policy first.")
        if method is None and len(known) == 1:
            method = known[0]
        if method not in known:
            given = "several methods" if method is None else f"no method {method!r}"
            raise RlcoError(
                f"{self.path} has {given}; give {option}= one of {', '.join(known)}."
            )
        return [row for row in self.rows if row["method"] == method]


class Comparison(NamedTuple):
    """Two methods in one environment, over the same initial states.

    Attributes:
        column: Task, domain and variation.
        seeds: Those that both have.
        left_out: Those that one of them has.
        episodes: Initial states in all.
        first: Share that the first method solves.
        second: The same of the second.
        first_only: Initial states that the first alone solves.
        second_only: Those that the second alone solves.
        p_value: Of the exact test of McNemar (1947): how likely a split at least as
            uneven is if either is as likely to be the one that solves.
        difference: First minus second. With one seed the interval is Newcombe's over
            initial states, for these two policies; with several Student's t over seeds,
            for the methods.
    """

    column: Column
    seeds: tuple[int, ...]
    left_out: tuple[int, ...]
    episodes: int
    first: float
    second: float
    first_only: int
    second_only: int
    p_value: float
    difference: Interval


def exact_paired_test(first_only: int, second_only: int) -> float:
    """Return the two-sided p-value of McNemar's exact test, in [0, 1].

    Pairs in which both succeed or both fail say nothing; of the others each is the
    first's with probability one half if the two are equally good (McNemar,
    Psychometrika 1947, with the binomial distribution in place of the normal one).

    Args:
        first_only: Pairs that the first alone solves.
        second_only: Pairs that the second alone solves.

    Example:
        >>> exact_paired_test(8, 0)  # 2 / 2^8
        0.0078125
        >>> exact_paired_test(0, 0)
        1.0
    """
    from scipy import stats  # a second, for what comes last

    total = first_only + second_only
    return float(stats.binomtest(first_only, total).pvalue) if total else 1.0


def read_evaluation(path: Path) -> Evaluation:
    """Return what a results.json or eval_info.json tells, or that of a folder.

    Args:
        path: The file, or the folder of a run that holds one.

    Raises:
        DataError: There is none, or it is damaged or tells no single episodes.
    """
    for name in (OURS, LEROBOT):
        if path.is_dir() and (path / name).is_file():
            return read_evaluation(path / name)
    if path.is_dir():
        raise DataError(
            f"{path} holds neither {OURS} nor {LEROBOT}; give the folder of an "
            "evaluation, or its file."
        )
    content = read_json(path, advice="let the evaluation write it again")
    if "per_task" in content.content or "per_episode" in content.content:
        return _of_lerobot(path, content)
    rows = read_results(path, of_recipe=True)
    return Evaluation(path, [cast(ResultRow, row) for row in rows])


def _of_lerobot(path: Path, content: Fields) -> Evaluation:
    """Return LeRobot's file as rows: one per task, or the only one of older files."""
    method = path.absolute().parent.name
    rows, states = [], dict[str, list[int]]()
    if "per_episode" in content.content:
        episodes = content.groups("per_episode")
        won = [_success(one.content.get("success"), one) for one in episodes]
        rows.append(_row(method, "task", won))
        states["task"] = [one.integer("seed", 0) for one in episodes]
    else:
        for one in content.groups("per_task"):
            task = f"{one.text('task_group')} {one.integer('task_id')}"
            results = one.group("metrics")
            won = [_success(x, results) for x in results.sequence("successes")]
            rows.append(_row(method, task, won))
    if not rows or not all(row["episodes"] for row in rows):
        raise DataError(f"{path} tells of no episode; evaluate again.")
    return Evaluation(path, rows, states)


def _success(value: object, place: Fields) -> int:
    if value not in (0, 1):  # True and False are
        raise place.refuse("success", "true or false")
    return int(bool(value))


def _row(method: str, task: str, won: list[int]) -> ResultRow:
    return ResultRow(
        method=method,
        task=task,
        policy="",
        domain=ONE_DOMAIN,
        variation=None,
        seed=0,
        episodes=len(won),
        successes=sum(won),
        outcomes=won,
    )


def compare(
    first: Sequence[ResultRow], second: Sequence[ResultRow]
) -> list[Comparison]:
    """Compare two methods wherever both were evaluated.

    Args:
        first: One method's rows, one per environment and seed.
        second: The other's.

    Raises:
        RlcoError: They have no environment or seed in common, one has a seed twice, or
            rows of one environment and seed have other initial states.
    """
    both = [column for column in columns(first) if column in columns(second)]
    if not both:
        raise RlcoError(
            f"the two have no environment in common: {_environments(first)} and "
            f"{_environments(second)}; evaluate both in the same task, domain and "
            "variation."
        )
    return [_compared(column, first, second) for column in both]


def _compared(
    column: Column, first: Sequence[ResultRow], second: Sequence[ResultRow]
) -> Comparison:
    one, other = _by_seed(first, column), _by_seed(second, column)
    seeds = tuple(sorted(one.keys() & other.keys()))
    if not seeds:
        raise RlcoError(
            f"{_words(column)}: seeds {sorted(one)} and {sorted(other)} have none in "
            "common; evaluate both methods with the same seeds."
        )
    won: list[bool] = []
    lost: list[bool] = []
    for seed in seeds:
        check_paired(one[seed], other[seed])
        won += map(bool, one[seed]["outcomes"])
        lost += map(bool, other[seed]["outcomes"])
    alone = sum(a and not b for a, b in zip(won, lost, strict=True))
    beaten = sum(b and not a for a, b in zip(won, lost, strict=True))
    if len(seeds) == 1:
        difference = paired_difference(won, lost)
    else:
        difference = paired_over_seeds(
            [one[seed] for seed in seeds], [other[seed] for seed in seeds]
        )
    return Comparison(
        column=column,
        seeds=seeds,
        left_out=tuple(sorted(one.keys() ^ other.keys())),
        episodes=len(won),
        first=sum(won) / len(won),
        second=sum(lost) / len(lost),
        first_only=alone,
        second_only=beaten,
        p_value=exact_paired_test(alone, beaten),
        difference=difference,
    )


def _by_seed(rows: Iterable[ResultRow], column: Column) -> dict[int, ResultRow]:
    found: dict[int, ResultRow] = {}
    for row in rows:
        if (row["task"], row["domain"], row["variation"]) != column:
            continue
        if row["seed"] in found:
            raise RlcoError(
                f"{row['method']} has seed {row['seed']} twice in {_words(column)}; "
                "give files with one row of each seed."
            )
        found[row["seed"]] = row
    return found


def _words(column: Column) -> str:
    return ", ".join(str(part) for part in column if part)


def _environments(rows: Sequence[ResultRow]) -> str:
    return "; ".join(_words(column) for column in columns(rows))


def table(found: Sequence[Comparison], first: str, second: str) -> str:
    """Return comparisons as a Markdown table."""
    lines = [
        f"| environment | {first} | {second} | difference, points [95 %] | "
        f"{first} alone | {second} alone | p | episodes | seeds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in found:
        estimate, low, high = (100.0 * value for value in one.difference)
        reach = "" if math.isnan(low) else f" [{low:+.1f}, {high:+.1f}]"
        cells = (
            _words(one.column),
            f"{one.first:.1%}",
            f"{one.second:.1%}",
            f"{estimate:+.1f}{reach}",
            one.first_only,
            one.second_only,
            f"{one.p_value:.2g}" if one.p_value else "0, to 300 digits",
            one.episodes,
            len(one.seeds),
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def notes(
    found: Sequence[Comparison], first: Evaluation, second: Evaluation
) -> list[str]:
    """Return what the table does not say, a sentence each.

    Raises:
        RlcoError: Both files tell what drew their initial states, and it differs.
    """
    said = []
    for task in first.states.keys() & second.states.keys():
        if first.states[task] != second.states[task]:
            raise RlcoError(
                f"the episodes of {first.path} and {second.path} began with other "
                "seeds; evaluate both with the same seed."
            )
    lerobot = [one for one in (first, second) if one.path.name == LEROBOT]
    if any(not one.states for one in lerobot):
        said.append(
            f"{LEROBOT} does not tell its seeds: the pairs are right only if both were "
            "evaluated with the same seed and the same number of environments."
        )
    for one in (first, second):
        alone = [c for c in columns(one.rows) if c not in [f.column for f in found]]
        if alone:
            said.append(
                f"what only {one.path} has is left out: {'; '.join(map(_words, alone))}"
            )
    left_out = sorted({seed for one in found for seed in one.left_out})
    if left_out:
        said.append(f"seeds that only one of the two has are left out: {left_out}")
    if any(len(one.seeds) == 1 for one in found):
        said.append(
            "one seed: intervals and p hold for these two policies, not for two methods"
        )
    if any(len(one.seeds) > 1 for one in found):
        said.append(
            "several seeds: the interval is over seeds, for the methods; p is over "
            "initial states, for these policies"
        )
    return said
