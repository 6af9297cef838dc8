"""What the maps of experiments measured, by how much sim teaches of the robot's part.

map.json is written by scripts/write_alignment_map.py from committed cells.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from rlco.reporting.statistics import Interval, mean_interval

#: What a column holds of each method: success in the robot's part, one number a seed.
METHODS = ("sim_only", "real_only", "sft", "rl_only", "rl_co")


@dataclass(frozen=True)
class Column:
    """One kind of gap between the simulator and a second one in the robot's part.

    Attributes:
        task: The task: ``planar``, of NumPy, or ``push_cube``, in MuJoCo.
        gap: What the second simulator differs in, in words.
        cross: What `recipes/align.py` calls ``cross``, one number a seed.
        success: By method, success at the end in the second simulator, one number a
            seed, from 0 to 1.
    """

    task: str
    gap: str
    cross: Sequence[float]
    success: Mapping[str, Sequence[float]]

    @property
    def share(self) -> float:
        """The mean of ``cross`` over the seeds."""
        return mean_interval(self.cross).estimate

    def mean(self, method: str) -> float:
        """Return a method's mean success over the seeds."""
        return mean_interval(self.success[method]).estimate

    def gain(self, first: str, second: str) -> Interval:
        """Return how much more often one method succeeds than another.

        The mean over the seeds of the differences within each, with Student's t
        interval of 95 %.

        Example:
            >>> success = {"rl_co": [0.5, 0.7], "sft": [0.4, 0.6]}
            >>> column = Column("planar", "turned", [0.1, 0.2], success)
            >>> round(column.gain("rl_co", "sft").estimate, 3)
            0.1
        """
        pairs = zip(self.success[first], self.success[second], strict=True)
        return mean_interval([one - other for one, other in pairs])


def read_map() -> list[Column]:
    """Return the columns of the maps, those first of which sim teaches least.

    Example:
        >>> columns = read_map()
        >>> columns[0].share < 0 < columns[-1].share
        True
    """
    text = files("rlco.reporting.alignment").joinpath("map.json").read_text("utf-8")
    columns = [Column(**entry) for entry in json.loads(text)["columns"]]
    return sorted(columns, key=lambda column: column.share)


def as_json(columns: Sequence[Column]) -> dict[str, Any]:
    """Return what map.json holds."""
    return {"columns": [vars(column) for column in columns]}


def neighbours(columns: Sequence[Column], share: float) -> list[Column]:
    """Return the columns of which sim teaches next less and next more.

    Args:
        columns: Those of the maps, the least share first.
        share: One's own.

    Returns:
        One column beyond either end of the maps, else two.

    Example:
        >>> low, high = (Column("planar", g, [c], {}) for g, c in [("a", 0), ("b", 1)])
        >>> [c.gap for c in neighbours([low, high], 0.5)]
        ['a', 'b']
        >>> [c.gap for c in neighbours([low, high], 1.5)]
        ['b']
    """
    below = [column for column in columns if column.share <= share][-1:]
    above = [column for column in columns if column.share > share][:1]
    return below + above


def in_words(column: Column) -> str:
    """Return what reinforcement learning and the anchor did in a column."""
    alone = points(column.gain("rl_only", "sft"))
    anchored = points(column.gain("rl_co", "rl_only"))
    return (
        f"{column.task}, {column.gap} ({in_percent(column.share)} explained): "
        f"imitation of both solved {in_percent(column.mean('sft'))} in the robot's "
        f"part, reinforcement learning alone ended {alone} points from there, and with "
        f"the anchor {anchored} points from that."
    )


def points(interval: Interval) -> str:
    """Return a difference of two success rates in points, with its interval.

    Example:
        >>> points(Interval(0.077, 0.025, 0.122))
        '+7.7 [+2.5, +12.2]'
    """
    low, high = 100 * interval.low, 100 * interval.high
    return f"{100 * interval.estimate:+.1f} [{low:+.1f}, {high:+.1f}]"


def in_percent(share: float) -> str:
    """Return a share in percent; below 0 the number itself says more.

    Example:
        >>> in_percent(0.756), in_percent(-1.2)
        ('76 %', 'none (-1.2)')
    """
    return f"{100 * share:.0f} %" if share > 0 else f"none ({share:.2g})"
