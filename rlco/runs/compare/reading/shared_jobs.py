"""Jobs that an experiment shares with another one, whose file has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rlco.errors import DataError
from rlco.files import read_yaml, shown
from rlco.files.reading import cut
from rlco.runs.compare.reading.plain_values import unusable
from rlco.runs.compare.reading.problems import Problems
from rlco.runs.compare.templates import flat, names_in
from rlco.runs.options import folder_name


def with_shared_jobs(
    problems: Problems, content: Mapping[str, Any], folder: Path
) -> Any:
    """Return what stands under ``jobs``, below the jobs that the file shares.

    These are the ones that its own jobs and its table name and that it has not itself,
    and those which they need, in the order of the other file. A job runs once for both
    experiments if they have the same ``out=``, since what decides its result is equal.

    Args:
        problems: What is wrong is added.
        content: Of the file; ``jobs_of`` names the other one.
        folder: Of both files.
    """
    own = content.get("jobs")
    # What is no mapping of jobs is refused as such.
    if "jobs_of" not in content or not isinstance(own, dict | None):
        return own
    shared, mine = _jobs_of(problems, content["jobs_of"], folder), own or {}
    problems.extend(
        f"job {shown(name)} is also a job of jobs_of: {shown(content['jobs_of'])}; "
        "give yours another name"
        for name in mine
        if name in shared
    )
    wanted = [*_named_in_table(content.get("table"))]
    wanted += [name for job in mine.values() for name in _needs(job)]
    needed: set[str] = set()
    while wanted:
        if (name := wanted.pop()) in shared and name not in needed:
            needed.add(name)
            wanted += _needs(shared[name])
    found = {name: job for name, job in shared.items() if name in needed}
    return {**found, **mine}


def _jobs_of(problems: Problems, given: Any, folder: Path) -> dict[str, Any]:
    """Return the jobs of the file that ``jobs_of`` names."""
    what = f"jobs_of: {shown(given)}"
    if not isinstance(given, str) or folder_name(given) is not None:
        problems.add(f"{what} is no name of a file beside this one; give one")
        return {}
    try:
        other = read_yaml(folder / given)
    except DataError as error:
        problems.add(f"{what}: {str(error).rstrip('.')}")
        return {}
    jobs = other.get("jobs") if isinstance(other, dict) else None
    if not isinstance(jobs, dict):
        problems.add(f"{what} has no jobs of its own; name the file that has them")
        return {}
    problems.extend(unusable(jobs, f"jobs of {cut(given)}"))
    return {str(name): job for name, job in jobs.items()}


def _named_in_table(table: Any) -> Iterator[str]:
    methods = table.get("methods") if isinstance(table, dict) else None
    for line in methods.values() if isinstance(methods, dict) else ():
        if isinstance(line, dict):
            yield str(line.get("job"))


def _needs(job: Any) -> list[str]:
    """Return the names that a job's options have in braces, variables among them."""
    options = job.get("options") if isinstance(job, dict) else None
    if not isinstance(options, dict):
        return []
    try:
        return names_in([*flat(options).values()])
    except ValueError:
        return []  # said with the job
