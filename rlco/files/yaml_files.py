"""YAML of others: plain values, numbers as people write them, bounded in size."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from rlco.errors import DataError, RlcoError
from rlco.files.reading import cut, reading
from rlco.files.texts import read_text

#: Characters of a file; options and effects take a few thousand.
_LONGEST = 1_000_000
#: Values with all aliases written out. A kilobyte of aliases of aliases stands for
#: more values than any memory holds.
_MOST = 200_000
# YAML 1.1 wants a sign in an exponent and a point in the number: 1e-3, -1.0e6 and 1e3
# would be text.
_FLOAT = re.compile(
    r"""^(?:[-+]?(?:[0-9][0-9_]*)\.[0-9_]*(?:[eE][-+]?[0-9]+)?
        |[-+]?(?:[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)
        |[-+]?\.[0-9_]+(?:[eE][-+]?[0-9]+)?
        |[-+]?\.(?:inf|Inf|INF)
        |\.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)


class _Loader(yaml.SafeLoader):
    """Plain values alone: no tag makes an object, no key stands twice."""

    # Before merges (<<: *anchor) are written out: what stands beside one may replace a
    # key that it brings.
    def compose_mapping_node(self, anchor: Any) -> Any:
        """Return a mapping as it is written; a key that stands twice is refused."""
        node = super().compose_mapping_node(anchor)
        seen: set[Any] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"{key.value!r} is given twice", key.start_mark
                    )
                seen.add(key.value)
        return node


_Loader.yaml_implicit_resolvers = {
    first: [(tag, found) for tag, found in pairs if tag != "tag:yaml.org,2002:float"]
    for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))


class _Dumper(yaml.SafeDumper):
    """Quotes a text that the loader would read as a number, such as 1e3."""


_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))


def yaml_text(content: Any, **options: Any) -> str:
    """Return plain values as YAML that `parse_yaml` reads again.

    Args:
        content: Of dicts, lists, texts, numbers, flags and None.
        options: Of `yaml.dump`.

    Example:
        >>> print(yaml_text({"name": "1e3", "damping": 1e3}), end="")
        name: '1e3'
        damping: 1000.0
    """
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, **options)
    return text


def read_yaml(
    path: Path,
    *,
    advice: str = "correct it",
    error: type[RlcoError] = DataError,
) -> Any:
    """Return what a YAML file holds: dicts, lists, texts, numbers, flags and None.

    Raises:
        RlcoError: Of the class `error`, if it is missing or no YAML, has a key twice,
            is longer than a megabyte, or its aliases stand for too many values.
    """
    text = read_text(path, most=4 * _LONGEST, advice=advice, error=error)
    return parse_yaml(text, path, advice=advice, error=error)


def parse_yaml(
    text: str,
    path: str | Path,
    *,
    advice: str = "correct it",
    error: type[RlcoError] = DataError,
) -> Any:
    """Return what a YAML text holds; `path` is what messages call it.

    Example:
        >>> parse_yaml("damping: -1.0e6", "effects.yaml")
        {'damping': -1000000.0}
    """
    if len(text) > _LONGEST:
        raise error(
            f"file {str(path)!r} is YAML of {len(text)} characters, and at most "
            f"{_LONGEST} are read; {advice}."
        )
    with reading(path, yaml.YAMLError, advice=advice, error=error):
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            if _size(node, {}, ()) > _MOST:
                raise error(
                    f"aliases of file {str(path)!r} stand for more than {_MOST} "
                    f"values; write out what is meant, and {advice}."
                )
            return loader.construct_document(node)
        except yaml.MarkedYAMLError as cause:
            mark = cause.problem_mark or cause.context_mark
            where = "" if mark is None else f" in line {mark.line + 1}"
            raise error(
                f"file {str(path)!r} is no YAML ({cut(str(cause.problem))}{where}); "
                f"{advice}."
            ) from cause
        finally:
            loader.dispose()


def _size(node: Any, known: dict[int, int], above: tuple[int, ...]) -> int:
    """Return how many values a node is with its aliases written out."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in above:
        raise yaml.YAMLError("an alias stands for what it is in")
    if id(node) not in known:
        inner = (*above, id(node))
        parts = node.value
        if isinstance(node, yaml.MappingNode):
            parts = [part for pair in node.value for part in pair]
        known[id(node)] = 1 + sum(_size(part, known, inner) for part in parts)
    return known[id(node)]
