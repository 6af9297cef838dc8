"""What of a log can be compared with the model, what is, and what the rest says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from rlco.errors import DataError, UnknownNameError
from rlco.files import few
from rlco.gap.compare.verdict import Gap, Verdict
from rlco.gap.compare.wording import amount, listed
from rlco.gap.logs.log import Log

Compared = Literal["positions", "torques", "poses", "task"]
#: What a user may ask for.
COMPARE = ("positions", "torques", "both")
_SHOWN = {
    "positions": "joint positions, simulated under the recorded commands",
    "torques": "measured joint torques, with those that the recorded motion takes",
    "poses": "a free body's pose, simulated from where it was let go",
    "task": "the tool and the objects, simulated under the task's recorded actions",
}


@dataclass(frozen=True)
class Comparison:
    """One way of comparing the log with the model, and what came of it.

    Attributes:
        compared: What was compared.
        verdict: What a search by it found; None where it is a check of another's: what
            those effects leave of this disagreement is in `gap`.
        gap: Its disagreement before and after, in all recordings where it is a check;
            None where it could not be compared.
        notes: What to know of it, a sentence each; the first ones warn.
        warned: Whether what it names may come from how it was measured.
    """

    compared: Compared
    verdict: Verdict | None = None
    gap: Gap | None = None
    notes: tuple[str, ...] = ()
    warned: bool = False


def possible(log: Log) -> tuple[Compared, ...]:
    """Return by what a log of joints can be compared, the better first.

    Example:
        >>> import numpy as np
        >>> from rlco.gap.logs.log import Recording
        >>> rows = np.zeros((2, 1))
        >>> recording = Recording("a", np.arange(2.0), rows, torque=rows)
        >>> possible(Log((recording,), joints=("j",)))
        ('torques',)
    """
    first, found = log.recordings[0], list[Compared]()
    if first.pose is not None or first.position is None:
        return ()
    if first.command is not None and log.actuators:
        found.append("positions")
    if first.torque is not None:
        found.append("torques")
    return tuple(found)


def chosen(log: Log, compare: str | None) -> tuple[Compared | None, Compared | None]:
    """Return what is compared and what beside it, as a check or as a second search.

    Args:
        log: The log.
        compare: One of `COMPARE`; None for what is possible, the better first.

    Returns:
        None for a log that is compared in its own way, a task's or a free body's.

    Raises:
        UnknownNameError: `compare` is another word.
        DataError: The log lacks what `compare` needs; says what.
    """
    if compare is not None and compare not in COMPARE:
        raise UnknownNameError("comparison", compare, COMPARE)
    there = possible(log)
    if compare is None:
        return there[0] if there else None, there[1] if len(there) > 1 else None
    asked = [kind for kind in _joints() if compare in (kind, "both")]
    lacking = [kind for kind in asked if kind not in there]
    if lacking:
        raise DataError(
            f"compare={compare} needs {_needed(lacking[0])}, which the log does not "
            f"have; {_instead(there)}."
        )
    return asked[0], asked[1] if len(asked) > 1 else None


def first_lines(
    log: Log, shown: Compared, beside: Compared | None, searched: bool
) -> list[str]:
    """Say what is compared, which columns are not, and what another one would need.

    Args:
        log: The log.
        shown: What is compared.
        beside: What is compared beside it.
        searched: Whether by that, too, effects are searched.
    """
    line = f"Compared: {_SHOWN[shown]}"
    if beside is not None:
        how = "in a search of their own" if searched else "as a check"
        line += f"; beside them, {how}, {_SHOWN[beside]}"
    lines = [f"{line}."]
    if log.unused:
        count = len(log.unused)
        lines.append(f"Left out: {count} column{'s'[: count > 1]}, {few(log.unused)}.")
    there = possible(log)
    lines += [
        f"To compare {kind} as well: {_missing(kind, log)}."
        for kind in _joints()
        if there and kind not in there
    ]
    if there and beside is None and len(there) > 1:
        other = "commands" if shown == "torques" else "torques"
        lines.append(f"The log has {other}, too: compare=both compares both.")
    return lines


def check_line(check: Comparison, effects: Sequence[str]) -> str:
    """Say what a check says of the effects that were found, in one sentence.

    Args:
        check: The comparison beside the one that was searched.
        effects: Those of the effects that change it, in words.
    """
    if check.gap is None:
        return f"A check by {check.compared} was not possible: {check.notes[0]}"
    before, after, floor = (
        amount(size, check.gap.unit)
        for size in (
            check.gap.before_heldout,
            check.gap.after_heldout,
            check.gap.noise_floor,
        )
    )
    if not effects:
        return (
            f"A check by {check.compared}: they disagree with the model by {before}; "
            f"their noise is {floor}."
        )
    return (
        f"A check by {check.compared}: with {listed(list(effects))} their disagreement "
        f"goes from {before} to {after}; their noise is {floor}."
    )


def warned(comparison: Comparison, warning: str | None) -> Comparison:
    """Return a comparison with a warning in front of its notes, where there is one."""
    if warning is None:
        return comparison
    return replace(comparison, notes=(warning, *comparison.notes), warned=True)


def _joints() -> list[Compared]:
    return [kind for kind in get_args(Compared) if kind in COMPARE]


def _needed(kind: Compared) -> str:
    if kind == "positions":
        return "joint positions and the commands that the actuators were sent"
    return "joint positions and measured joint torques"


def _instead(there: Sequence[Compared]) -> str:
    if there:
        return f"give compare={there[0]}, or leave it out"
    return "it is a task's or a free body's: leave compare= out"


def _missing(kind: Compared, log: Log) -> str:
    if kind == "positions":
        return (
            "give the commands that were sent, in columns such as command.JOINT, and a "
            "model with a servo for each"
        )
    currents = [name for name in log.unused if "current" in name.lower()]
    if currents:
        return (
            "give joint torques [N m] in columns such as tau.JOINT; "
            f"{few(currents, 3)} are currents: multiply each by torque constant and "
            f"gear ratio [N m/A], scale={currents[0]}:NUMBER,..., and call them "
            f"torques, rename={currents[0]}:tau_NAME"
        )
    return "give measured joint torques, in columns such as tau.JOINT"
