"""What is wrong in a file, collected: all of it is said at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, suggest
from rlco.files import few, shown
from rlco.files.reading import cut
from rlco.runs.compare.templates import fields_in, takes

#: Of one file: who reads further corrects these first.
_MOST = 30
#: Names that a misspelt one is compared with; with thousands it would take seconds.
_MOST_ALIKE = 1000
_MOST_LISTED = 20  # names that a sentence lists


class Problems:
    """What is wrong in a file.

    Attributes:
        found: A sentence each, without its full stop; the first ones where there are
            very many.
    """

    def __init__(self) -> None:
        self.found: list[str] = []

    def add(self, *sentences: str) -> None:
        """Add what is wrong."""
        self.extend(sentences)

    def extend(self, sentences: Iterable[str]) -> None:
        """Add all that is wrong of a kind; sentences too many are not even made."""
        for sentence in sentences:
            if len(self.found) == _MOST:
                return
            self.found.append(sentence)

    def refuse(self, path: Path) -> None:
        """Raise all that is wrong in a file, if anything is.

        Raises:
            ConfigError: Something is.
        """
        if not self.found:
            return
        problems = [f"in {path}: {problem}" for problem in self.found]
        if len(problems) == _MOST:
            problems.append("correct these first, and what else there is is said then")
        raise ConfigError(problems)

    def known(
        self, given: Mapping[Any, Any], allowed: Collection[str], what: str
    ) -> None:
        """Check names against those allowed."""
        self.extend(
            f"{what} has an unknown {shown(name)}{_alike(str(name), allowed)}; known: "
            f"{_listed(allowed)}"
            for name in given
            if name not in allowed
        )

    def mapping(self, given: Any, what: str) -> dict[str, Any]:
        """Return a mapping that must be there."""
        if isinstance(given, dict) and given:
            return {str(key): value for key, value in given.items()}
        self.add(f"{what} is missing, or is no mapping of names")
        return {}

    def text(self, given: Any, what: str) -> str:
        """Return a name, which may look like a number."""
        if given is None or isinstance(given, bool | list | dict):
            self.add(f"{what} is {shown(given)}; give one name")
        return str(given)

    def names(
        self,
        value: Any,
        what: str,
        over: Mapping[str, tuple[Any, ...]],
        jobs: Collection[str] = (),
    ) -> list[str]:
        """Return the names in a template's braces, checked with their formats.

        Args:
            value: The template, or a list of them.
            what: What it is called.
            over: The values of the variables that it may name.
            jobs: The jobs that it may name.
        """
        try:
            found = [*dict.fromkeys(fields_in(value))]
        except ValueError as error:
            self.add(f"{what}: {error}; write {{{{ for a brace itself")
            return []
        kind, allowed = "variable and no job above it", {**over, **dict.fromkeys(jobs)}
        self.named([name for name, _ in found], allowed, what, kind, quoted="{{{}}}")
        self.extend(
            f"{what} has {{{name}:{form}}}, but a job's folder takes no format; write "
            f"{{{name}}}"
            for name, form in found
            if form and name in jobs
        )
        self.extend(
            f"{what} has {{{name}:{form}}}, a format that {shown(value)} does not "
            f"take; write {{{name}}}"
            for name, form in found
            for value in over.get(name, ())
            if form and not takes(value, form)
        )
        return [name for name, _ in found if name in allowed]

    def named(
        self,
        names: Iterable[str],
        allowed: Collection[str],
        what: str,
        kind: str,
        *,
        quoted: str = "{!r}",
    ) -> None:
        """Check that names are those of something of a kind."""
        self.extend(
            f"{what} names {cut(quoted.format(name))}{_alike(name, allowed)}, which is "
            f"no {kind}; known: {_listed(allowed)}"
            for name in names
            if name not in allowed
        )

    def values(
        self, given: Mapping[Any, Any], over: Mapping[str, tuple[Any, ...]], what: str
    ) -> None:
        """Check the values that variables are to have, by their names."""
        self.known(given, over, f"{what}'s at")
        self.each(given.items(), over, f"{what}'s at")

    def each(
        self,
        given: Iterable[tuple[Any, Any]],
        over: Mapping[str, tuple[Any, ...]],
        what: str,
    ) -> None:
        """Check single values of those variables that there are."""
        self.extend(
            f"{what} has {name}: {shown(value)}, which is no value of it; known: "
            f"{_listed(over[name])}"
            for name, value in given
            if name in over and value not in over[name]
        )


def _alike(name: str, allowed: Collection[str]) -> str:
    return suggest(name, allowed) if len(allowed) <= _MOST_ALIKE else ""


def _listed(names: Collection[Any]) -> str:
    return few([*map(str, names)], _MOST_LISTED)
