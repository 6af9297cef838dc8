"""An experiment as its YAML file says it.

Everything that is wrong in a file is reported together, before anything runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, DataError, suggest
from rlco.files import read_yaml
from rlco.runs.compare.code_version import ROOT
from rlco.runs.compare.experiment import (
    Experiment,
    JobKind,
    Line,
    Prediction,
    Published,
    Table,
    Without,
    labels_of,
)
from rlco.runs.compare.templates import flat, names_in

#: Options that the runner gives itself, and one whose file it could not hash.
_OWN = ("out", "resume", "config")


def read_experiment(path: Path) -> Experiment:
    """Read an experiment from its file.

    .. code-block:: yaml

        name: anchor
        over:                    # variables; of jobs that cost the same, those with
          seed: [0, 1, 2]        # earlier values of the first variable run first
          beta: [0, 0.2]
        without:                 # combinations that are not run; may be left out
          - {seed: 2, beta: 0}
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

    ``{seed}`` is a variable's value; ``{sft}`` the run folder of the job ``sft`` with
    the same values of the variables that it has. A job may need those written above it.

    Raises:
        ConfigError: Everything that is wrong in the file.
    """
    content = _content(path)
    reader = _Reader(path)
    reader.known(content, ("name", "over", "without", "jobs", "table"), "the file")
    name = content.get("name", path.stem)
    over = reader.over(content.get("over"))
    without = reader.without(content.get("without") or [], over)
    jobs = reader.jobs(content.get("jobs"), over)
    table = reader.table(content.get("table"), over, jobs)
    if reader.problems:
        raise ConfigError([f"in {path}: {problem}" for problem in reader.problems])
    return Experiment(str(name), over, jobs, table, without)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_yaml(path)
    except DataError as error:
        raise ConfigError([str(error).rstrip(".")]) from error
    if not isinstance(content, dict):
        raise ConfigError([f"{path} must hold name, over, jobs and table"])
    return content


class _Reader:
    """Reads the parts of a file and collects what is wrong in them."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        self.problems: list[str] = []

    def known(
        self, given: Mapping[Any, Any], allowed: Sequence[str], what: str
    ) -> None:
        """Check names against those allowed."""
        self.problems += [
            f"{what} has an unknown {name!r}{suggest(str(name), allowed)}; known: "
            f"{', '.join(allowed)}"
            for name in given
            if name not in allowed
        ]

    def mapping(self, given: Any, what: str) -> dict[str, Any]:
        """Return a mapping that must be there."""
        if isinstance(given, dict) and given:
            return {str(key): value for key, value in given.items()}
        self.problems.append(f"{what} is missing, or is no mapping of names")
        return {}

    def over(self, given: Any) -> dict[str, tuple[Any, ...]]:
        """Return the values of each variable."""
        found = {}
        for name, values in self.mapping(given, "over").items():
            if not isinstance(values, list) or not values:
                self.problems.append(f"over {name} is no list of values")
            elif any(isinstance(value, list | dict) for value in values):
                self.problems.append(f"over {name} holds lists; give single values")
            elif len({str(value) for value in values}) < len(values):
                self.problems.append(f"over {name} holds a value twice")
            elif not name.isidentifier():
                self.problems.append(f"over {name!r} is no name; use letters and _")
            else:
                found[name] = tuple(values)
        return found

    def without(
        self, given: Any, over: Mapping[str, tuple[Any, ...]]
    ) -> tuple[Without, ...]:
        """Return the combinations that are not run."""
        found = []
        for one in given if isinstance(given, list) else [given]:
            if not (isinstance(one, dict) and one):
                self.problems.append(
                    f"without holds {one!r}, which is no mapping of variables to values"
                )
                continue
            self.known(one, list(over), "without")
            values = {
                str(name): tuple(each) if isinstance(each, list) else (each,)
                for name, each in one.items()
            }
            self.problems += [
                f"without has {name}: {value!r}, which is no value of it; known: "
                f"{', '.join(map(str, over[name]))}"
                for name, each in values.items()
                for value in each
                if name in over and value not in over[name]
            ]
            found.append(values)
        return tuple(found)

    def names(self, value: Any, what: str, allowed: Iterable[str]) -> list[str]:
        """Return the names in a template's braces, checked."""
        try:
            found = names_in(value)
        except ValueError as error:
            self.problems.append(f"{what}: {error}; write {{{{ for a brace itself")
            return []
        allowed = list(allowed)
        self.problems += [
            f"{what} names {{{name}}}{suggest(name, allowed)}, which is no variable "
            f"and no job above it; known: {', '.join(allowed)}"
            for name in found
            if name not in allowed
        ]
        return [name for name in found if name in allowed]

    # -- Jobs --------------------------------------------------------------------------

    def jobs(
        self, given: Any, over: Mapping[str, tuple[Any, ...]]
    ) -> dict[str, JobKind]:
        """Return the jobs by their names."""
        found: dict[str, JobKind] = {}
        for name, content in self.mapping(given, "jobs").items():
            if name in over or not name.isidentifier():
                self.problems.append(
                    f"job {name!r} needs a name of letters and _, other than variables'"
                )
            elif isinstance(content, dict):
                found[name] = self.job(name, content, over, found)
            else:
                self.problems.append(f"job {name} is no mapping with a script")
        return found

    def job(
        self,
        name: str,
        content: Mapping[str, Any],
        over: Mapping[str, tuple[Any, ...]],
        above: Mapping[str, JobKind],
    ) -> JobKind:
        """Return one job."""
        what = f"job {name}"
        known = ("script", "options", "minutes", "curves", "results")
        self.known(content, known, what)
        options = flat(content.get("options") or {})
        self.problems += [
            f"{what} cannot have the option {own}, which the runner decides; leave it "
            "out, and write what a config holds as options"
            for own in _OWN
            if own in options
        ]
        used = self.names(list(options.values()), what, [*over, *above])
        needs = tuple(dict.fromkeys(one for one in used if one in above))
        mine = {*used, *(v for need in needs for v in above[need].variables)}
        minutes = content.get("minutes", 1)
        if isinstance(minutes, bool) or not isinstance(minutes, int | float):
            self.problems.append(f"{what} has minutes: {minutes!r}, which is no number")
            minutes = 1
        results = content.get("results", True)
        if not isinstance(results, bool):
            self.problems.append(
                f"{what} has results: {results!r}; give false where its script writes "
                "no results.json, or leave it out"
            )
        return JobKind(
            name,
            str(content.get("script")),
            self.script(content.get("script"), what),
            options,
            float(minutes),
            tuple(content.get("curves", ["metrics.csv"])),
            results is not False,
            needs,
            tuple(variable for variable in over if variable in mine),
        )

    def script(self, given: Any, what: str) -> Path:
        """Return a script's file: as given, beside the YAML, or in the checkout."""
        places = [folder / str(given) for folder in (Path(), self.folder, ROOT)]
        # Where a wheel has the recipes.
        places.append(ROOT / "rlco" / "_recipes" / Path(str(given)).name)
        for path in places:
            if given and path.is_file():
                return path.resolve()
        self.problems.append(
            f"{what} has script {given!r}, which is no file here, beside this file or "
            f"in {ROOT}"
        )
        return Path()

    # -- The table ---------------------------------------------------------------------

    def table(
        self,
        given: Any,
        over: Mapping[str, tuple[Any, ...]],
        jobs: Mapping[str, JobKind],
    ) -> Table:
        """Return what is compared."""
        content = self.mapping(given, "table")
        known = ["by", "seed", "methods", "differences", "predictions", "published"]
        known += ["curve_episodes", "mean", "axis", "domains"]
        self.known(content, known, "table")
        by, mean, domains = (
            given if isinstance(given, list) else [given]
            for given in (content.get(name, []) for name in ("by", "mean", "domains"))
        )
        seed = str(content.get("seed", "seed"))
        for name in [*by, seed]:
            if name not in over:
                self.problems.append(
                    f"table names {name!r}{suggest(name, over)}, which is no variable; "
                    f"known: {', '.join(over)}"
                )
        lines = tuple(
            self.line(label, content_of, jobs, over, {*by, seed})
            for label, content_of in self.mapping(
                content.get("methods"), "table's methods"
            ).items()
        )
        labels = {label for line in lines for label in labels_of(line.label, over)}
        pairs = self.differences(content.get("differences") or [], labels)
        predictions = self.predictions(content.get("predictions") or [], labels)
        episodes = content.get("curve_episodes")
        if episodes is not None and not isinstance(episodes, int):
            self.problems.append(f"table's curve_episodes is {episodes!r}, no number")
        axis = content.get("axis")
        self.problems += [
            f"table has {name}: {value!r}, which is none of by; known: "
            f"{', '.join(map(str, by)) or 'none'}"
            for name, given in (("mean", mean), ("axis", [axis] if axis else []))
            for value in given
            if value not in by
        ]
        published = self.published(content.get("published") or [], labels, over)
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

    def published(
        self, given: Any, labels: Iterable[str], over: Mapping[str, tuple[Any, ...]]
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
                self.problems.append(
                    f"table's published {one!r} is not of the form {{source: WHO, at: "
                    "{VARIABLE: VALUE}, success: {METHOD: RATE}}, rates from 0 to 1"
                )
                continue
            self.labels(map(str, success), labels, "table's published")
            self.at(one["at"], over, "table's published")
            found.append(Published(str(one["source"]), one["at"], success))
        return tuple(found)

    def at(
        self, given: Mapping[Any, Any], over: Mapping[str, tuple[Any, ...]], what: str
    ) -> None:
        """Check values of variables."""
        self.known(given, list(over), f"{what}'s at")
        self.problems += [
            f"{what}'s at has {name}: {value!r}, which is no value of it; known: "
            f"{', '.join(map(str, over[name]))}"
            for name, value in given.items()
            if name in over and value not in over[name]
        ]

    def differences(
        self, given: Any, labels: Iterable[str]
    ) -> tuple[tuple[str, str], ...]:
        """Return the pairs of labels that are subtracted."""
        found = []
        for pair in given if isinstance(given, list) else [given]:
            if not (isinstance(pair, list) and len(pair) == 2):
                self.problems.append(f"table's difference {pair!r} is no pair [A, B]")
                continue
            found.append((str(pair[0]), str(pair[1])))
            self.labels(found[-1], labels, "table's difference")
        return tuple(found)

    def predictions(self, given: Any, labels: Iterable[str]) -> tuple[Prediction, ...]:
        """Return the rank correlations that are computed."""
        found = []
        known = ("gain", "falls_with", "domain")
        for one in given if isinstance(given, list) else [given]:
            gain = one.get("gain") if isinstance(one, dict) else None
            if not (isinstance(gain, list) and len(gain) == 2 and set(one) == {*known}):
                self.problems.append(
                    f"table's prediction {one!r} is not of the form "
                    "{gain: [A, B], falls_with: C, domain: D}"
                )
                continue
            pair, third = (str(gain[0]), str(gain[1])), str(one["falls_with"])
            self.labels((*pair, third), labels, "table's prediction")
            found.append(Prediction(pair, third, str(one["domain"])))
        return tuple(found)

    def labels(self, named: Iterable[str], known: Iterable[str], what: str) -> None:
        """Check the labels of methods against those of the table."""
        known = sorted(known)
        self.problems += [
            f"{what} names {label!r}{suggest(label, known)}, which is no method; "
            f"known: {', '.join(known)}"
            for label in named
            if label not in known
        ]

    def line(
        self,
        label: str,
        content: Any,
        jobs: Mapping[str, JobKind],
        over: Mapping[str, Any],
        elsewhere: set[str],
    ) -> Line:
        """Return one method of the table."""
        what = f"table's method {label!r}"
        content = self.mapping(content, what)
        self.known(content, ("job", "method", "curve", "at"), what)
        at = content.get("at", {})
        if not isinstance(at, dict):
            self.problems.append(f"{what} has at: {at!r}, which maps no variables")
            at = {}
        self.at(at, over, what)
        job = str(content.get("job"))
        method, curve = (
            None if (given := content.get(name)) is None else str(given)
            for name in ("method", "curve")
        )
        named = self.names(label, what, over)
        if job not in jobs:
            self.problems.append(
                f"{what} has job {job!r}{suggest(job, jobs)}; known: {', '.join(jobs)}"
            )
            return Line(label, job, method, curve, at)
        if not jobs[job].results:
            self.problems.append(f"{what} has job {job!r}, which has no results")
        missing = {*jobs[job].variables} - elsewhere - {*named, *at}
        if missing:
            braces = " ".join(f"{{{name}}}" for name in sorted(missing))
            self.problems.append(
                f"{what} mixes all values of {', '.join(sorted(missing))}; put "
                f"{braces} into its label, or the variable into by"
            )
        return Line(label, job, method, curve, at)
