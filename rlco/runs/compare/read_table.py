"""The table of an experiment as its YAML file says it: what is compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rlco.errors import suggest
from rlco.runs.compare.experiment import (
    JobKind,
    Line,
    Prediction,
    Published,
    Table,
    labels_of,
)
from rlco.runs.compare.problems import Problems


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
    by, mean, domains = (
        given if isinstance(given, list) else [given]
        for given in (content.get(name, []) for name in ("by", "mean", "domains"))
    )
    seed = str(content.get("seed", "seed"))
    problems.named([*by, seed], list(over), "table", "variable")
    lines = tuple(
        _line(problems, label, content_of, jobs, over, {*by, seed})
        for label, content_of in problems.mapping(
            content.get("methods"), "table's methods"
        ).items()
    )
    labels = sorted({one for line in lines for one in labels_of(line.label, over)})
    pairs = _differences(problems, content.get("differences") or [], labels)
    predictions = _predictions(problems, content.get("predictions") or [], labels)
    episodes = content.get("curve_episodes")
    if episodes is not None and not isinstance(episodes, int):
        problems.found.append(f"table's curve_episodes is {episodes!r}, no number")
    axis = content.get("axis")
    problems.found += [
        f"table has {name}: {value!r}, which is none of by; known: "
        f"{', '.join(map(str, by)) or 'none'}"
        for name, given in (("mean", mean), ("axis", [axis] if axis else []))
        for value in given
        if value not in by
    ]
    published = _published(problems, content.get("published") or [], labels, over)
    return Table(
        by=tuple(by),
        seed=seed,
        lines=lines,
        differences=pairs,
        predictions=predictions,
        curve_episodes=episodes,
        mean=tuple(mean),
        axis=axis,
        domains=tuple(map(str, domains)),
        published=published,
    )


def _published(
    problems: Problems,
    given: Any,
    labels: Sequence[str],
    over: Mapping[str, tuple[Any, ...]],
) -> tuple[Published, ...]:
    """Return what others reported."""
    found = []
    for one in given if isinstance(given, list) else [given]:
        success = one.get("success") if isinstance(one, dict) else None
        if not (
            isinstance(success, dict)
            and {*one} == {"source", "at", "success"}
            and isinstance(one["at"], dict)
            and all(
                isinstance(rate, int | float) and 0 <= rate <= 1
                for rate in success.values()
            )
        ):
            problems.found.append(
                f"table's published {one!r} is not of the form {{source: WHO, at: "
                "{VARIABLE: VALUE}, success: {METHOD: RATE}}, rates from 0 to 1"
            )
            continue
        problems.named(map(str, success), labels, "table's published", "method")
        problems.values(one["at"], over, "table's published")
        found.append(Published(str(one["source"]), one["at"], success))
    return tuple(found)


def _differences(
    problems: Problems, given: Any, labels: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Return the pairs of labels that are subtracted."""
    found = []
    for pair in given if isinstance(given, list) else [given]:
        if not (isinstance(pair, list) and len(pair) == 2):
            problems.found.append(f"table's difference {pair!r} is no pair [A, B]")
            continue
        found.append((str(pair[0]), str(pair[1])))
        problems.named(found[-1], labels, "table's difference", "method")
    return tuple(found)


def _predictions(
    problems: Problems, given: Any, labels: Sequence[str]
) -> tuple[Prediction, ...]:
    """Return the rank correlations that are computed."""
    found = []
    known = ("gain", "falls_with", "domain")
    for one in given if isinstance(given, list) else [given]:
        gain = one.get("gain") if isinstance(one, dict) else None
        if not (isinstance(gain, list) and len(gain) == 2 and set(one) == {*known}):
            problems.found.append(
                f"table's prediction {one!r} is not of the form "
                "{gain: [A, B], falls_with: C, domain: D}"
            )
            continue
        pair, third = (str(gain[0]), str(gain[1])), str(one["falls_with"])
        problems.named((*pair, third), labels, "table's prediction", "method")
        found.append(Prediction(pair, third, str(one["domain"])))
    return tuple(found)


def _line(
    problems: Problems,
    label: str,
    content: Any,
    jobs: Mapping[str, JobKind],
    over: Mapping[str, Any],
    elsewhere: set[str],
) -> Line:
    """Return one method of the table."""
    what = f"table's method {label!r}"
    content = problems.mapping(content, what)
    problems.known(content, ("job", "method", "curve", "at"), what)
    at = content.get("at", {})
    if not isinstance(at, dict):
        problems.found.append(f"{what} has at: {at!r}, which maps no variables")
        at = {}
    problems.values(at, over, what)
    job = str(content.get("job"))
    method, curve = (
        None if (given := content.get(name)) is None else str(given)
        for name in ("method", "curve")
    )
    named = problems.names(label, what, over)
    if job not in jobs:
        problems.found.append(
            f"{what} has job {job!r}{suggest(job, jobs)}; known: {', '.join(jobs)}"
        )
        return Line(label, job, method, curve, at)
    if not jobs[job].results:
        problems.found.append(f"{what} has job {job!r}, which has no results")
    several = {name for name in jobs[job].variables if len(over[name]) > 1}
    missing = several - elsewhere - {*named, *at}
    if missing:
        braces = " ".join(f"{{{name}}}" for name in sorted(missing))
        problems.found.append(
            f"{what} mixes all values of {', '.join(sorted(missing))}; put "
            f"{braces} into its label, or the variable into by"
        )
    return Line(label, job, method, curve, at)
