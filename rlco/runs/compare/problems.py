"""What is wrong in a file, collected: all of it is said at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rlco.errors import suggest
from rlco.runs.compare.templates import names_in


class Problems:
    """What is wrong in a file.

    Attributes:
        found: A sentence each, without its full stop.
    """

    def __init__(self) -> None:
        self.found: list[str] = []

    def known(
        self, given: Mapping[Any, Any], allowed: Sequence[str], what: str
    ) -> None:
        """Check names against those allowed."""
        self.found += [
            f"{what} has an unknown {name!r}{suggest(str(name), allowed)}; known: "
            f"{', '.join(allowed)}"
            for name in given
            if name not in allowed
        ]

    def mapping(self, given: Any, what: str) -> dict[str, Any]:
        """Return a mapping that must be there."""
        if isinstance(given, dict) and given:
            return {str(key): value for key, value in given.items()}
        self.found.append(f"{what} is missing, or is no mapping of names")
        return {}

    def names(self, value: Any, what: str, allowed: Iterable[str]) -> list[str]:
        """Return the names in a template's braces, checked."""
        try:
            found = names_in(value)
        except ValueError as error:
            self.found.append(f"{what}: {error}; write {{{{ for a brace itself")
            return []
        allowed = list(allowed)
        kind = "variable and no job above it"
        self.named(found, allowed, what, kind, quoted="{{{}}}")
        return [name for name in found if name in allowed]

    def named(
        self,
        names: Iterable[str],
        allowed: Sequence[str],
        what: str,
        kind: str,
        *,
        quoted: str = "{!r}",
    ) -> None:
        """Check that names are those of something of a kind."""
        self.found += [
            f"{what} names {quoted.format(name)}{suggest(name, allowed)}, which is no "
            f"{kind}; known: {', '.join(allowed)}"
            for name in names
            if name not in allowed
        ]

    def values(
        self, given: Mapping[Any, Any], over: Mapping[str, tuple[Any, ...]], what: str
    ) -> None:
        """Check the values that variables are to have, by their names."""
        self.known(given, list(over), f"{what}'s at")
        self.found += [
            f"{what}'s at has {name}: {value!r}, which is no value of it; known: "
            f"{', '.join(map(str, over[name]))}"
            for name, value in given.items()
            if name in over and value not in over[name]
        ]
