"""The jobs of an experiment as its YAML file says them: what is run."""

from __future__ import annotations

import os.path
import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePath
from typing import Any

from rlco.errors import DataError
from rlco.files import shown
from rlco.files.fields import is_number
from rlco.files.reading import cut
from rlco.runs.compare.code_version import ROOT, check_python
from rlco.runs.compare.experiment import JobKind
from rlco.runs.compare.reading.limits import check_jobs, check_options
from rlco.runs.compare.reading.problems import Problems
from rlco.runs.compare.templates import flat

Over = Mapping[str, tuple[Any, ...]]

#: Options that the runner gives itself, and one whose file it could not hash.
_OWN = ("out", "resume", "config")
# Other names could be two options, out=here among them.
_OPTION = re.compile(r"\w[\w.-]*")
_MOST_MINUTES = 1_000_000  # two years
_PATTERN = 200  # characters of a curve's
_NOWHERE = Path("/dev/null/nowhere")


def read_jobs(
    problems: Problems, given: Any, over: Over, folder: Path
) -> dict[str, JobKind]:
    """Return the jobs by their names.

    Args:
        problems: What is wrong is added.
        given: What stands under ``jobs``.
        over: The values of the variables.
        folder: Where the file is, and maybe its scripts.
    """
    found: dict[str, JobKind] = {}
    for name, content in problems.mapping(given, "jobs").items():
        if name in over or not name.isidentifier():
            problems.add(
                f"job {shown(name)} needs a name of letters and _, other than "
                "variables'"
            )
        elif isinstance(content, dict):
            found[name] = _job(problems, name, content, over, found, folder)
        else:
            problems.add(f"job {cut(name)} is no mapping with a script")
    check_jobs(problems, found.values(), over)
    return found


def _job(
    problems: Problems,
    name: str,
    content: Mapping[str, Any],
    over: Over,
    above: Mapping[str, JobKind],
    folder: Path,
) -> JobKind:
    """Return one job."""
    what = f"job {cut(name)}"
    known = ("script", "options", "minutes", "curves", "results")
    problems.known(content, known, what)
    options = _options(problems, what, content.get("options"))
    used = problems.names(list(options.values()), what, over, above)
    check_options(problems, what, options, over, above)
    needs = tuple(dict.fromkeys(one for one in used if one in above))
    mine = {*used, *(v for need in needs for v in above[need].variables)}
    results = content.get("results", True)
    if not isinstance(results, bool):
        problems.add(
            f"{what} has results: {shown(results)}; give false where its script writes "
            "no results.json, or leave it out"
        )
    return JobKind(
        name,
        str(content.get("script")),
        _script(problems, what, content.get("script"), folder),
        options,
        _minutes(problems, what, content.get("minutes", 1)),
        _curves(problems, what, content.get("curves", ["metrics.csv"])),
        results is not False,
        needs,
        tuple(variable for variable in over if variable in mine),
    )


def _options(problems: Problems, what: str, given: Any) -> dict[str, Any]:
    """Return a job's options, groups as dotted names."""
    if given is None:
        return {}
    if not isinstance(given, dict):
        problems.add(f"{what} has options: {shown(given)}; give names with values")
        return {}
    problems.extend(
        f"{what} has an option {shown(name)}; give a name of letters, digits, _, . or -"
        for name in _names(given)
        if not (isinstance(name, str) and _OPTION.fullmatch(name))
    )
    options = flat(given)
    problems.extend(
        f"{what} cannot have the option {own}, which the runner decides; leave it "
        "out, and write what a config holds as options"
        for own in _OWN
        if own in options
    )
    return options


def _names(group: Mapping[Any, Any]) -> Iterator[Any]:
    for name, value in group.items():
        yield name
        if isinstance(value, dict):
            yield from _names(value)


def _minutes(problems: Problems, what: str, given: Any) -> float:
    if is_number(given) and 0 <= given <= _MOST_MINUTES:
        return float(given)
    problems.add(
        f"{what} has minutes: {shown(given)}; give the time expected on one processor, "
        f"a number from 0 to {_MOST_MINUTES}"
    )
    return 1.0


def _curves(problems: Problems, what: str, given: Any) -> tuple[str, ...]:
    """Return the tables of a run folder that are kept, as glob patterns."""
    patterns = [given] if isinstance(given, str) else given
    if not isinstance(patterns, list):
        problems.add(
            f"{what} has curves: {shown(given)}; give a list of tables in its run "
            "folder, such as [metrics.csv]"
        )
        return ()
    problems.extend(
        f"{what} has a curve {shown(one)}; give the name of a table in its run folder, "
        f"such as metrics.csv, without .. and of at most {_PATTERN} characters"
        for one in patterns
        if not _is_pattern(one)
    )
    return tuple(map(str, patterns))


def _is_pattern(given: Any) -> bool:
    """Return whether a value is a glob pattern that stays in its folder."""
    if not isinstance(given, str) or not 0 < len(given) <= _PATTERN:
        return False
    if ".." in PurePath(given).parts:
        return False
    try:
        list(_NOWHERE.glob(given))  # absolute ones are refused there
    except (ValueError, NotImplementedError, IndexError):
        return False
    return True


def _script(problems: Problems, what: str, given: Any, folder: Path) -> Path:
    """Return a script's file: as given, beside the YAML, or in the checkout."""
    candidates = [place / str(given) for place in (Path(), folder, ROOT)]
    # Where a wheel has the recipes.
    candidates.append(ROOT / "rlco" / "_recipes" / Path(str(given)).name)
    # Of a name that is too long for one, Path.is_file raises an error.
    path = next((one for one in candidates if given and os.path.isfile(one)), None)
    if path is None:
        problems.add(
            f"{what} has script {shown(given)}, which is no file here, beside this "
            f"file or in {ROOT}"
        )
        return Path()
    path = path.resolve()
    try:
        check_python(path)
    except DataError as error:
        problems.add(f"{what}: {str(error)[:-1]}")
    return path
