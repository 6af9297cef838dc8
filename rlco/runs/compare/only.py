"""A part of an experiment: the jobs with some values of its variables."""

from __future__ import annotations

from collections.abc import Sequence

from rlco.errors import ConfigError
from rlco.files import few, shown
from rlco.runs.compare.experiment import Experiment
from rlco.runs.compare.jobs import Job
from rlco.runs.compare.templates import plain


def only(
    jobs: Sequence[Job], experiment: Experiment, values: Sequence[str]
) -> list[Job]:
    """Return the jobs with some values of variables, and those that vary with none.

    Args:
        jobs: All of them.
        experiment: What they are of.
        values: ``NAME=VALUE`` each; several of one name are alternatives. Without any,
            all jobs are returned.

    Raises:
        ConfigError: One is not written so, or names no value of the experiment.
    """
    wanted: dict[str, set[str]] = {}
    problems = []
    for given in map(str, values):  # brackets in brackets are a list in it
        name, sign, value = given.partition("=")
        what = f"only={shown(given)}"
        if not sign or name not in experiment.over:
            problems.append(
                f"{what} is no variable and value; give NAME=VALUE, NAME one of "
                f"{few([*experiment.over])}"
            )
            continue
        known = [str(plain(each)) for each in experiment.over[name]]
        if value not in known:
            problems.append(
                f"{what}: the experiment has no such value of {name}; it has "
                f"{few(known)}"
            )
        wanted.setdefault(name, set()).add(value)
    if problems:
        raise ConfigError(problems)
    return [
        job
        for job in jobs
        if all(
            str(plain(job.values[name])) in wanted[name]
            for name in wanted & job.values.keys()
        )
    ]
