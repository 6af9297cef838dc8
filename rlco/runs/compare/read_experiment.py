"""An experiment as its YAML file says it.

Everything that is wrong in a file is reported together, before anything runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, DataError
from rlco.files import read_yaml
from rlco.runs.compare.code_version import ROOT
from rlco.runs.compare.experiment import Experiment, JobKind, Without, value_name
from rlco.runs.compare.jobs import file_hash
from rlco.runs.compare.problems import Problems
from rlco.runs.compare.read_table import read_table
from rlco.runs.compare.templates import flat

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
        files:                   # SHA-256 of files in options that tables can be made
          weights.pth: b0353...  # without; may be left out
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
    reader.problems.known(
        content, ("name", "over", "without", "files", "jobs", "table"), "the file"
    )
    name = content.get("name", path.stem)
    over = reader.over(content.get("over"))
    without = reader.without(content.get("without") or [], over)
    files = reader.files(content["files"]) if "files" in content else {}
    jobs = reader.jobs(content.get("jobs"), over)
    table = read_table(reader.problems, content.get("table"), over, jobs)
    if reader.problems.found:
        raise ConfigError(
            [f"in {path}: {problem}" for problem in reader.problems.found]
        )
    return Experiment(str(name), over, jobs, table, without, files)


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
        self.problems = Problems()

    def over(self, given: Any) -> dict[str, tuple[Any, ...]]:
        """Return the values of each variable."""
        found = {}
        for name, values in self.problems.mapping(given, "over").items():
            if not isinstance(values, list) or not values:
                self.problems.found.append(f"over {name} is no list of values")
            elif any(isinstance(value, list | dict) for value in values):
                self.problems.found.append(
                    f"over {name} holds lists; give single values"
                )
            elif len({value_name(value) for value in values}) < len(values):
                self.problems.found.append(f"over {name} holds a value twice")
            elif not name.isidentifier():
                self.problems.found.append(
                    f"over {name!r} is no name; use letters and _"
                )
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
                self.problems.found.append(
                    f"without holds {one!r}, which is no mapping of variables to values"
                )
                continue
            self.problems.known(one, list(over), "without")
            values = {
                str(name): tuple(each) if isinstance(each, list) else (each,)
                for name, each in one.items()
            }
            self.problems.found += [
                f"without has {name}: {value!r}, which is no value of it; known: "
                f"{', '.join(map(str, over[name]))}"
                for name, each in values.items()
                for value in each
                if name in over and value not in over[name]
            ]
            found.append(values)
        return tuple(found)

    def files(self, given: Any) -> dict[str, str]:
        """Return the SHA-256 of files that may be absent."""
        found = {}
        for path, value in self.problems.mapping(given, "files").items():
            digest, present = str(value), file_hash(path)
            if not re.fullmatch(r"[0-9a-f]{64}", digest):
                self.problems.found.append(
                    f"files has {path}: {value!r}; give its SHA-256, 64 digits of "
                    "0 to 9 and a to f"
                )
            elif present not in (None, digest):
                self.problems.found.append(
                    f"files has {path}: {digest[:12]}..., but the file there has "
                    f"{present[:12]}...; put the one there that is meant"
                )
            found[path] = digest
        return found

    # -- Jobs --------------------------------------------------------------------------

    def jobs(
        self, given: Any, over: Mapping[str, tuple[Any, ...]]
    ) -> dict[str, JobKind]:
        """Return the jobs by their names."""
        found: dict[str, JobKind] = {}
        for name, content in self.problems.mapping(given, "jobs").items():
            if name in over or not name.isidentifier():
                self.problems.found.append(
                    f"job {name!r} needs a name of letters and _, other than variables'"
                )
            elif isinstance(content, dict):
                found[name] = self.job(name, content, over, found)
            else:
                self.problems.found.append(f"job {name} is no mapping with a script")
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
        self.problems.known(content, known, what)
        options = flat(content.get("options") or {})
        self.problems.found += [
            f"{what} cannot have the option {own}, which the runner decides; leave it "
            "out, and write what a config holds as options"
            for own in _OWN
            if own in options
        ]
        used = self.problems.names(list(options.values()), what, [*over, *above])
        needs = tuple(dict.fromkeys(one for one in used if one in above))
        mine = {*used, *(v for need in needs for v in above[need].variables)}
        minutes = content.get("minutes", 1)
        if isinstance(minutes, bool) or not isinstance(minutes, int | float):
            self.problems.found.append(
                f"{what} has minutes: {minutes!r}, which is no number"
            )
            minutes = 1
        results = content.get("results", True)
        if not isinstance(results, bool):
            self.problems.found.append(
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
        self.problems.found.append(
            f"{what} has script {given!r}, which is no file here, beside this file or "
            f"in {ROOT}"
        )
        return Path()
