"""Errors that a user can cause; each builds its own one-sentence message.

A message says what was given, what is allowed, and what to do. Recipes print it
without a traceback and exit with status 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

#: Of a name [characters].
_LONGEST = 200


class RlcoError(ValueError):
    """Base of every error that wrong input can cause.

    What it quotes of a file cannot move the cursor of a terminal, see `printable`.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))

    def __reduce__(self) -> tuple[Any, ...]:
        # Between processes: the constructors of most kinds take no message.
        return _remade, (type(self), self.args, self.__dict__)


def _remade(
    kind: type[RlcoError], args: tuple[Any, ...], state: dict[str, Any]
) -> RlcoError:
    error = kind.__new__(kind, *args)
    error.__dict__ |= state
    return error


def printable(text: str) -> str:
    r"""Return a text with its control characters, such as a terminal's, written out.

    Example:
        >>> printable("q1 \x1b[2J")
        'q1 \\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "backslashreplace").decode("ascii")


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, which gets an "s" where it is not one.

    Example:
        >>> counted(1, "action"), counted(7, "action")
        ('1 action', '7 actions')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def suggest(given: str, allowed: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for a near miss, else an empty string.

    Example:
        >>> suggest("sim_ration", ["sim_ratio", "seed"])
        " (did you mean 'sim_ratio'?)"
    """
    if len(given) > _LONGEST:  # no slip of the pen, and it would take minutes
        return ""
    near = difflib.get_close_matches(given, list(allowed), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


class UnknownNameError(RlcoError):
    """A name that is not among the known ones.

    Example:
        >>> str(UnknownNameError("task", "push_cub", ["push_cube"]))
        "unknown task 'push_cub' (did you mean 'push_cube'?); known: push_cube."
    """

    def __init__(self, kind: str, given: str, allowed: Sequence[str]) -> None:
        super().__init__(
            f"unknown {kind} {given[:_LONGEST]!r}{suggest(given, allowed)}; "
            f"known: {', '.join(allowed)}."
        )


class ConfigError(RlcoError):
    """One or more problems in a recipe's options, all reported together."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(problems) + ".")


class DataError(RlcoError):
    """A data set that cannot be used as it is."""


class OutputExistsError(RlcoError):
    """An output folder that exists already; nothing in it was touched."""

    def __init__(self, path: object, *, resumable: bool = False) -> None:
        more = ", or resume=DIR to continue that run" if resumable else ""
        super().__init__(
            f"output folder {str(path)!r} exists and is not overwritten; "
            f"give another out=DIR{more}."
        )


class CheckpointError(RlcoError):
    """A checkpoint that does not fit what it is loaded into."""


class NonFiniteError(RlcoError):
    """Numbers of a training that are NaN or infinite; nothing goes on from them."""


class LostProcessError(RlcoError):
    """Another process of a training has ended; what was saved is there."""


class RenderingError(RlcoError):
    """No OpenGL library to render with."""

    def __init__(self, backend: str, reason: str) -> None:
        super().__init__(
            f"cannot render with MUJOCO_GL={backend!r} ({reason}); install the Debian "
            "packages libegl1 libgl1-mesa-dri libosmesa6 and set MUJOCO_GL=egl or "
            "MUJOCO_GL=osmesa, or go on without images and video."
        )


class SimulationError(RlcoError):
    """A simulation that diverged."""

    def __init__(self, task: str, environments: Sequence[int]) -> None:
        super().__init__(
            f"the simulation of {task!r} diverged (NaN) in environments "
            f"{list(environments)}; check the model's masses, gains and time step."
        )


class NoSignalError(RlcoError):
    """A rollout from which reinforcement learning can learn nothing."""

    def __init__(self, solved: int, episodes: int) -> None:
        advice = (
            "train Stage I longer or on more demonstrations until it solves some, or "
            "use reward=shaped"
            if solved < episodes
            else "the policy needs no more of it: evaluate it"
        )
        super().__init__(
            f"nothing can be learnt from this rollout: {solved} of {episodes} episodes "
            f"were solved and all have the same return, so no action is better than "
            f"another; {advice}."
        )
