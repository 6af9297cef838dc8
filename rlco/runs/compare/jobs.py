"""The jobs of an experiment, one for each combination of values, and their keys."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rlco.runs.compare.code_version import Code, read_code
from rlco.runs.compare.experiment import Experiment, JobKind, left_out
from rlco.runs.compare.templates import filled, plain


@dataclass(frozen=True)
class Job:
    """One run, and what decides its result.

    Attributes:
        kind: The job as written.
        values: Of its variables.
        needs: The jobs whose folders it reads, by their names.
        code: What it runs.
        files: SHA-256 of files that may be absent, by their paths.
    """

    kind: JobKind
    values: Mapping[str, Any]
    needs: Mapping[str, Job]
    code: Code
    files: Mapping[str, str]

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Job) and self.key == other.key

    @cached_property
    def name(self) -> str:
        """What it is called where people read it.

        It names the job and the values: ``rl_beta0.2_seed3``.
        """
        return job_name(self.kind.name, self.values)

    @property
    def folder(self) -> str:
        """The name of its folder."""
        return f"{self.name}-{self.key[:8]}"

    @cached_property
    def identity(self) -> str:
        """A hash of script and options, whatever the version of the code."""
        folders = {name: f"job:{job.identity}" for name, job in self.needs.items()}
        return _hash(self._decided_by(folders))

    @cached_property
    def key(self) -> str:
        """A hash of all that decides the result: script, options, code."""
        folders = {name: f"job:{job.key}" for name, job in self.needs.items()}
        return _hash({**self._decided_by(folders), "code": self.code.version})

    def options(self, folders: Mapping[str, str]) -> dict[str, str]:
        """Return the options as the command line takes them.

        Args:
            folders: The run folder of each job that it needs.
        """
        names = {**self.values, **folders}
        return {key: filled(value, names) for key, value in self.kind.options.items()}

    def _decided_by(self, folders: Mapping[str, str]) -> dict[str, Any]:
        options = self.options(folders)
        return {
            "script": self.kind.script,
            "options": {key: self._contents(value) for key, value in options.items()},
        }

    def _contents(self, value: str) -> str:
        """Replace a file's path by its hash: where it is decides nothing."""
        digest = self.files.get(value) or file_hash(value)
        return value if digest is None else f"file:{digest}"


def job_name(kind: str, values: Mapping[str, Any]) -> str:
    """Return what a job of some values is called, see `Job.name`.

    Example:
        >>> job_name("rl", {"domain": "domains/yaw30.yaml", "seed": 3})
        'rl_domaindomains-yaw30.yaml_seed3'
    """
    parts = [kind, *(f"{name}{plain(value)}" for name, value in values.items())]
    return re.sub(r"[^\w.+-]+", "-", "_".join(parts))


def file_hash(path: str) -> str | None:
    """Return the SHA-256 of a file; None: there is none at this path.

    Devices and pipes are none, nor what the kernel makes up: some of them never end.
    """
    place = Path(path)
    try:
        if not place.is_file() or place.resolve().is_relative_to("/proc"):
            return None
        with place.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def _hash(content: Any) -> str:
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def expand(experiment: Experiment) -> list[Job]:
    """Return every job but those left out, those that others need before them.

    Jobs of one kind come in the order of the values; the first variable changes last.
    """
    code = {path: read_code(path) for path in {k.path for k in _kinds(experiment)}}
    found: dict[tuple[str, tuple[Any, ...]], Job] = {}
    for kind in _kinds(experiment):
        for combination in itertools.product(
            *(experiment.over[name] for name in kind.variables)
        ):
            values = dict(zip(kind.variables, combination, strict=True))
            if left_out(values, experiment.without):
                continue
            needs = {
                need: find(found, experiment.jobs[need], values) for need in kind.needs
            }
            found[kind.name, combination] = Job(
                kind, values, needs, code[kind.path], experiment.files
            )
    return list(found.values())


def _kinds(experiment: Experiment) -> list[JobKind]:
    return list(experiment.jobs.values())


def find(
    jobs: Mapping[tuple[str, tuple[Any, ...]], Job],
    kind: JobKind,
    values: Mapping[str, Any],
) -> Job:
    """Return the job of a kind with these values of the variables that it has."""
    return jobs[kind.name, tuple(values[name] for name in kind.variables)]
