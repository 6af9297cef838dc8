"""What a resumed run must find as it left it: its options and its inputs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rlco.errors import CheckpointError, RlcoError
from rlco.files import Fields, shown
from rlco.files.fingerprints import fingerprint
from rlco.files.own_code import source_of
from rlco.runs.config import to_plain
from rlco.runs.metrics import MetricsFile
from rlco.runs.options import options_of

#: Where a run is, not what it does.
_ELSEWHERE = ("out", "resume")
#: What the modules are called, among the inputs, that options name as MODULE:NAME.
_CODE = "MODULE:NAME"


def options_by_name(config: object) -> dict[str, Any]:
    """Return the options of a run by their dotted names, in types that JSON holds."""
    plain = to_plain(config)
    found = {}
    for key in options_of(type(config)):
        value: Any = plain
        for part in key.split("."):
            value = value[part]
        found[key] = value
    return {key: value for key, value in found.items() if key not in _ELSEWHERE}


def inputs_of(config: object) -> dict[str, dict[str, str]]:
    """Return the fingerprints of the files that options name: by option, by path."""
    given = options_by_name(config)
    found = {}
    for key, entry in options_of(type(config)).items():
        values = given[key] if isinstance(given.get(key), list) else [given.get(key)]
        paths = [v for v in values if entry.input and isinstance(v, str) and v]
        # A folder that happens to have the name of a domain is none.
        there = {
            path: fingerprint(Path(path))
            for path in paths
            if Path(path).is_file() or (entry.input == "folder" and Path(path).is_dir())
        }
        if there:
            found[key] = there
    texts = [v for v in given.values() if isinstance(v, str)]
    texts += [v for vs in given.values() if isinstance(vs, list) for v in vs]
    code = {t: source_of(t) for t in texts if isinstance(t, str)}
    sources = {text: fingerprint(path) for text, path in code.items() if path}
    return found | ({_CODE: sources} if sources else {})


def check_unchanged(
    path: Path, info: Fields, config: object
) -> dict[str, dict[str, str]]:
    """Check that a run goes on with the options and the inputs that it began with.

    Runs from before these were written down are not checked.

    Args:
        path: The run's folder.
        info: Its run.json.
        config: What it is to go on with, from its config.yaml and the command line.

    Returns:
        The inputs where they are now, see `inputs_of`.

    Raises:
        RlcoError: An option that may not change, or an input, is another one.
    """
    entries = options_of(type(config))
    began = info.mapping("options", {})
    now = options_by_name(config)
    inputs: Mapping[str, Any] = info.mapping("inputs", {})
    for key, value in began.items():
        if key not in entries or entries[key].may_change or key in inputs:
            continue
        if now[key] != value:
            raise RlcoError(
                f"run {str(path)!r} was started with {key}={shown(value)}, and now has "
                f"{key}={shown(now[key])}, in its config.yaml or given; put it back, "
                "or start a new run."
            )
    if not inputs:
        return {}
    present = inputs_of(config)
    for key, before in inputs.items():
        if (key not in entries and key != _CODE) or not isinstance(before, dict):
            continue
        # Paths may differ: a run and its data may have been moved together.
        found = present.get(key, {})
        if key in began:
            same = _by_content(now[key], found) == _by_content(began[key], before)
        else:
            same = list(found.values()) == list(before.values())
        if not same:
            named = f"{key}={shown(now[key])}" if key in now else "code of your own"
            raise RlcoError(
                f"{named} is not what run {str(path)!r} was started "
                f"with ({', '.join(map(shown, before))}): its content differs or is "
                "missing; put it back, give it where it is now, or start a new run."
            )
    return present


def _by_content(value: Any, found: Mapping[str, str]) -> list[Any]:
    """Return what an option says, with the content of a file for its path."""
    values = value if isinstance(value, list) else [value]
    return [found.get(one, one) if isinstance(one, str) else one for one in values]


def check_checkpoint(path: Path, saved: Any, metrics: MetricsFile) -> None:
    """Check that a checkpoint is of a run, and that the run's table is as it was then.

    Args:
        path: Its file, for messages.
        saved: What is in it; those from before have no digest of the table.
        metrics: The table, what came after the checkpoint taken away.

    Raises:
        CheckpointError: It is none, or rows are missing or were changed.
    """
    if not isinstance(saved, dict) or not {"state", "rng"} <= saved.keys():
        raise CheckpointError(
            f"checkpoint {str(path)!r} is none of a run: it holds no state and random "
            "numbers; take the file away to resume from the one before."
        )
    if saved.get("metrics", metrics.digest()) != metrics.digest():
        raise CheckpointError(
            f"{str(metrics.path)!r} is not what it was when checkpoint {path.name} was "
            "saved: rows are missing or were changed; put it back, or start a new run."
        )
