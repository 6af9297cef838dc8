"""The table of an experiment as its YAML file says it: what is compared."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from rlco.errors import suggest
from rlco.files import few, shown
from rlco.files.fields import is_number
from rlco.runs.compare.experiment import (
    JobKind,
    Line,
    Prediction,
    Published,
    Table,
    labels_of,
)
from rlco.runs.compare.reading.limits import fits
from rlco.runs.compare.reading.problems import Problems

#: Behind a point of a curve.
_MOST_EPISODES = 1_000_000


def read_table(
    problems: Problems,
    given: Any,
    over: Mapping[str, tuple[Any, ...]],
    jobs: Mapping[str, JobKind],
) -> Table:
    """Return what is compared.

    Args:
        problems: What is wrong is added.
        given: What stands under ``table``.
        over: The values of the variables.
        jobs: The jobs by their names.
    """
    content = problems.mapping(given, "table")
    known = ["by", "seed", "methods", "differences", "predictions", "published"]
    known += ["curve_episodes", "mean", "axis", "domains"]
    problems.known(content, known, "table")
    by, mean = ([*map(str, _listed(content.get(name)))] for name in ("by", "mean"))
    domains = _listed(content.get("domains"))
    seed = str(content.get("seed", "seed"))
    problems.named([*by, seed], over, "table", "variable")
    axis = None if (one := content.get("axis")) is None else str(one)
    problems.extend(
        f"table has {name}: {shown(value)}, which is none of by; known: "
        f"{few(by) or 'none'}"
        for name, values in (("mean", mean), ("axis", [] if axis is None else [axis]))
        for value in values
        if value not in by
    )
    methods = problems.mapping(content.get("methods"), "table's methods")
    lines = tuple(
        _line(problems, label, content_of, jobs, over, {*by, seed})
        for label, content_of in methods.items()
    )
    table = Table(
        by=tuple(by),
        seed=seed,
        lines=lines,
        differences=(),
        predictions=(),
        curve_episodes=_episodes(problems, content.get("curve_episodes")),
        mean=tuple(mean),
        axis=axis,
        domains=tuple(problems.text(one, "table's domain") for one in domains),
    )
    pairs, predictions, published = (
        _listed(content.get(name))
        for name in ("differences", "predictions", "published")
    )
    beside = len(pairs) + len(predictions) + len(published)
    if not fits(problems, lines, beside, by, over):
        return table
    labels = dict.fromkeys(
        sorted(one for line in lines for one in labels_of(line.label, over))
    )
    return replace(
        table,
        differences=_differences(problems, pairs, labels),
        predictions=_predictions(problems, predictions, labels),
        published=_published(problems, published, labels, over),
    )


def _listed(given: Any) -> list[Any]:
    """Return what may stand alone, in a list, or not at all."""
    if given is None:
        return []
    return given if isinstance(given, list) else [given]


def _episodes(problems: Problems, given: Any) -> int | None:
    if given is None:
        return None
    if type(given) is int and 0 < given <= _MOST_EPISODES:
        return given
    problems.add(
        f"table's curve_episodes is {shown(given)}, no number of episodes; give a "
        f"whole one from 1 to {_MOST_EPISODES}, or leave it out"
    )
    return None


def _published(
    problems: Problems,
    given: Iterable[Any],
    labels: Collection[str],
    over: Mapping[str, tuple[Any, ...]],
) -> tuple[Published, ...]:
    """Return what others reported."""
    found = []
    for one in given:
        success = one.get("success") if isinstance(one, dict) else None
        if not (
            isinstance(success, dict)
            and {*one} == {"source", "at", "success"}
            and isinstance(one["at"], dict)
            and all(is_number(rate) and 0 <= rate <= 1 for rate in success.values())
        ):
            problems.add(
                f"table's published {shown(one)} is not of the form {{source: WHO, at: "
                "{VARIABLE: VALUE}, success: {METHOD: RATE}}, rates from 0 to 1"
            )
            continue
        rates = {str(label): rate for label, rate in success.items()}
        problems.named(rates, labels, "table's published", "method")
        problems.values(one["at"], over, "table's published")
        source = problems.text(one["source"], "table's published source")
        found.append(Published(source, one["at"], rates))
    return tuple(found)


def _differences(
    problems: Problems, given: Iterable[Any], labels: Collection[str]
) -> tuple[tuple[str, str], ...]:
    """Return the pairs of labels that are subtracted."""
    found = []
    for pair in given:
        if not (isinstance(pair, list) and len(pair) == 2):
            problems.add(f"table's difference {shown(pair)} is no pair [A, B]")
            continue
        found.append((str(pair[0]), str(pair[1])))
        problems.named(found[-1], labels, "table's difference", "method")
    return tuple(found)


def _predictions(
    problems: Problems, given: Iterable[Any], labels: Collection[str]
) -> tuple[Prediction, ...]:
    """Return the rank correlations that are computed."""
    found = []
    known = ("gain", "falls_with", "domain")
    for one in given:
        gain = one.get("gain") if isinstance(one, dict) else None
        if not (isinstance(gain, list) and len(gain) == 2 and set(one) == {*known}):
            problems.add(
                f"table's prediction {shown(one)} is not of the form "
                "{gain: [A, B], falls_with: C, domain: D}"
            )
            continue
        pair, third = (str(gain[0]), str(gain[1])), str(one["falls_with"])
        problems.named((*pair, third), labels, "table's prediction", "method")
        domain = problems.text(one["domain"], "table's prediction's domain")
        found.append(Prediction(pair, third, domain))
    return tuple(found)


def _line(
    problems: Problems,
    label: str,
    content: Any,
    jobs: Mapping[str, JobKind],
    over: Mapping[str, tuple[Any, ...]],
    elsewhere: set[str],
) -> Line:
    """Return one method of the table."""
    what = f"table's method {shown(label)}"
    content = problems.mapping(content, what)
    problems.known(content, ("job", "method", "curve", "at"), what)
    at = content.get("at", {})
    if not isinstance(at, dict):
        problems.add(f"{what} has at: {shown(at)}, which maps no variables")
        at = {}
    problems.values(at, over, what)
    job = str(content.get("job"))
    method, curve = (
        None
        if (given := content.get(name)) is None
        else problems.text(given, f"{what}'s {name}")
        for name in ("method", "curve")
    )
    named = problems.names(label, what, over)
    line = Line(label, job, method, curve, at)
    if job not in jobs:
        problems.add(
            f"{what} has job {shown(job)}{suggest(job, jobs)}; known: {few([*jobs])}"
        )
        return line
    if not jobs[job].results:
        problems.add(f"{what} has job {job!r}, which has no results")
    mine = jobs[job].variables
    if others := [name for name in named if name not in mine]:
        problems.add(
            f"{what} names {_braces(others)}, with which job {job} does not vary; "
            "leave it out of the label"
        )
    several = {name for name in mine if len(over[name]) > 1}
    missing = several - elsewhere - {*named, *at}
    if missing:
        problems.add(
            f"{what} mixes all values of {', '.join(sorted(missing))}; put "
            f"{_braces(missing)} into its label, or the variable into by"
        )
    return line


def _braces(names: Iterable[str]) -> str:
    return " ".join(f"{{{name}}}" for name in sorted({*names}))
