"""An experiment as its YAML file says it.

Everything that is wrong in a file is reported together, before anything runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, DataError
from rlco.files import read_yaml, shown
from rlco.files.reading import cut
from rlco.runs.compare.experiment import Experiment, Without, value_name
from rlco.runs.compare.jobs import file_hash
from rlco.runs.compare.reading.limits import MOST_VALUES, check_without
from rlco.runs.compare.reading.plain_values import unusable
from rlco.runs.compare.reading.problems import Problems
from rlco.runs.compare.reading.read_jobs import read_jobs
from rlco.runs.compare.reading.read_table import read_table
from rlco.runs.compare.reading.shared_jobs import with_shared_jobs
from rlco.runs.compare.templates import plain
from rlco.runs.options import folder_name


def read_experiment(path: Path) -> Experiment:
    """Read an experiment from its file.

    .. code-block:: yaml

        name: anchor
        over:                    # variables; of jobs that cost the same, those with
          seed: [0, 1, 2]        # earlier values of the first variable run first
          beta: [0, 0.2]
        without:                 # combinations that are not run; may be left out
          - {seed: 2, beta: 0}
        files:                   # SHA-256 of files in options that tables can be made
          weights.pth: b0353...  # without; may be left out
        jobs_of: other.yaml      # has jobs that are named and not here; may be left out
        jobs:                    # each runs once for all values of what it names
          sim:
            script: recipes/record_demos.py
            results: false       # it makes data, and writes no results.json
            options: {domain: sim, episodes: 40, seed: "{seed}"}
          sft:
            script: recipes/sft.py
            minutes: 2           # expected, on one processor
            options: {sim_demos: "{sim}", real_demos: demos/real, seed: "{seed}"}
          rl:
            script: recipes/rl_co.py
            minutes: 20
            options: {policy: "{sft}/policy", real_coeff: "{beta}", seed: "{seed}",
                      real_demos: demos/real}
        table:
          methods:
            sft: {job: sft, method: sft}
            beta {beta}: {job: rl, curve: metrics.csv}  # drawn, too
          differences: [[beta 0.2, sft], [beta 0.2, beta 0]]
          # With `by: gap`, the rank correlation of two means over the gaps:
          # predictions: [{gain: [beta 0.2, beta 0], falls_with: sft, domain: stand_in}]
          # `mean: gap` adds means over the gaps, `axis: gap` draws success over them,
          # `domains: [sim]` leaves the others out, and a method with `at: {gap: yaw0}`
          # is the one of that gap in every table. What others reported stands beside:
          # published: [{source: a paper, at: {gap: yaw0}, success: {sft: 0.4}}]

    ``{seed}`` is a variable's value, ``{seed:03d}`` with a format; ``{sft}`` the run
    folder of the job ``sft`` with the same values of the variables that it has. A job
    may need those written above it.

    Raises:
        ConfigError: Everything that is wrong in the file.
    """
    content, problems = _content(path), Problems()
    # What is wrong with single values would also be in the way of all else.
    problems.extend(unusable(content))
    problems.refuse(path)
    known = ("name", "over", "without", "files", "jobs_of", "jobs", "table")
    problems.known(content, known, "the file")
    name = _name(problems, content.get("name", path.stem))
    over = _over(problems, content.get("over"))
    without = _without(problems, content.get("without") or [], over)
    files = _files(problems, content["files"]) if "files" in content else {}
    given = with_shared_jobs(problems, content, path.parent)
    problems.refuse(path)  # of jobs that are not there more would be wrong
    jobs = read_jobs(problems, given, over, path.parent)
    table = read_table(problems, content.get("table"), over, jobs)
    problems.refuse(path)
    return Experiment(name, over, jobs, table, without, files)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_yaml(path)
    except DataError as error:
        raise ConfigError([str(error).rstrip(".")]) from error
    if not isinstance(content, dict):
        raise ConfigError([f"{path} must hold name, over, jobs and table"])
    return content


def _name(problems: Problems, given: Any) -> str:
    """Return what the experiment is called, and the folder of its jobs."""
    name = problems.text(given, "name")
    if (wrong := folder_name(name)) is not None or name in (".", ".."):
        problems.add(f"name: {wrong or f'{name!r} is a folder itself'}; give another")
    return name


def _over(problems: Problems, given: Any) -> dict[str, tuple[Any, ...]]:
    """Return the values of each variable."""
    found = {}
    for name, values in problems.mapping(given, "over").items():
        what = f"over {cut(name)}"
        if not isinstance(values, list) or not values:
            problems.add(f"{what} is no list of values")
        elif len(values) > MOST_VALUES:
            problems.add(
                f"{what} has {len(values)} values, and at most {MOST_VALUES} are taken"
            )
        elif any(isinstance(value, list | dict) for value in values):
            problems.add(f"{what} holds lists; give single values")
        elif odd := [v for v in values if isinstance(v, date) or v != v]:
            problems.add(
                f"{what} holds {shown(str(odd[0]))}, which is no value that results "
                "name; put it into quotes"
            )
        elif min(len({*values}), len({*map(_called, values)})) < len(values):
            problems.add(f"{what} holds a value twice")
        elif not name.isidentifier():
            problems.add(f"over {shown(name)} is no name; use letters and _")
        else:
            found[name] = tuple(values)
    return found


def _called(value: Any) -> str:
    return value_name(plain(value))


def _without(
    problems: Problems, given: Any, over: Mapping[str, tuple[Any, ...]]
) -> tuple[Without, ...]:
    """Return the combinations that are not run."""
    found = []
    for one in given if isinstance(given, list) else [given]:
        if not (isinstance(one, dict) and one):
            problems.add(
                f"without holds {shown(one)}, which is no mapping of variables to "
                "values"
            )
            continue
        problems.known(one, over, "without")
        values = {
            str(name): tuple(each) if isinstance(each, list) else (each,)
            for name, each in one.items()
        }
        single = [(name, value) for name, each in values.items() for value in each]
        problems.each(single, over, "without")
        found.append(values)
    check_without(problems, found)
    return tuple(found)


def _files(problems: Problems, given: Any) -> dict[str, str]:
    """Return the SHA-256 of files that may be absent."""
    found = {}
    for path, value in problems.mapping(given, "files").items():
        digest, present = str(value), file_hash(path)
        if not re.fullmatch(r"[0-9a-f]{64}", digest):
            problems.add(
                f"files has {cut(path)}: {shown(value)}; give its SHA-256, 64 digits "
                "of 0 to 9 and a to f"
            )
        elif present not in (None, digest):
            problems.add(
                f"files has {cut(path)}: {digest[:12]}..., but the file there has "
                f"{present[:12]}...; put the one there that is meant"
            )
        found[path] = digest
    return found
