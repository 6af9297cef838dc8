"""JSON of others: read whole, damage reported in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rlco.errors import DataError, RlcoError
from rlco.files.fields import Fields
from rlco.files.reading import reading
from rlco.files.sizes import check_held

#: Characters of a JSON text: Python's objects take some twenty times their text.
LONGEST = 40_000_000
#: Bytes of a text for which there is always memory.
_SMALL = 2**26


def read_text(
    path: Path,
    *,
    encoding: str = "utf-8",
    errors: str = "strict",
    most: int | None = None,
    advice: str = "copy it again",
    error: type[RlcoError] = DataError,
) -> str:
    """Return a file's text.

    Args:
        path: The file.
        encoding: Its own.
        errors: What becomes of bytes that are no text, as in `open`.
        most: How long it may be [bytes]; None: what half of the memory holds.
        advice: What to do about a file that cannot be read.
        error: What is raised.

    Raises:
        RlcoError: Of the class `error`, if it is missing, too long or no text.
    """
    if path.is_dir():
        raise error(f"{str(path)!r} is no file; {advice}.")
    with reading(path, advice=advice, error=error):
        size = path.stat().st_size
        if most is not None and size > most:
            raise error(
                f"file {str(path)!r} is a text of {size / 1e6:.1f} MB, and at most "
                f"{most / 1e6:g} MB are read; {advice}."
            )
        if size > _SMALL:
            check_held(2 * size, f"the text of {str(path)!r}", advice)
        return path.read_text(encoding, errors)


def parse_json(
    text: str,
    path: Path,
    *,
    advice: str = "copy it again",
    error: type[RlcoError] = DataError,
) -> Any:
    """Return the content of a JSON text from a file.

    Raises:
        RlcoError: Of the class `error`, if it is no JSON, or nested too deeply, or of
            more than 40 million characters.
    """
    if len(text) > LONGEST:
        raise error(
            f"file {str(path)!r} holds {len(text)} characters of JSON, and at most "
            f"{LONGEST} are read; {advice}."
        )
    with reading(path, advice=advice, error=error):
        return json.loads(text)


def read_json(
    path: Path,
    *,
    advice: str = "copy it again",
    error: type[RlcoError] = DataError,
) -> Fields:
    """Return the fields of a JSON file that holds one object.

    Raises:
        RlcoError: Of the class `error`, if it is missing, damaged or another thing.
    """
    text = read_text(path, most=4 * LONGEST, advice=advice, error=error)
    content = parse_json(text, path, advice=advice, error=error)
    return Fields(content, f"file {str(path)!r}", error, advice)


def read_json_lines(path: Path) -> list[Fields]:
    """Return the fields of each line of a file with one JSON object a line.

    Raises:
        DataError: If it is missing or damaged, or a line is no object.
    """
    lines = read_text(path).splitlines()
    return [
        Fields(parse_json(line, path), f"line {number} of file {str(path)!r}")
        for number, line in enumerate(lines, 1)
        if line.strip()
    ]
