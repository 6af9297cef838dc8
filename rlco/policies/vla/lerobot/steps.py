"""What the JSON of a LeRobot checkpoint may name, as LeRobot runs whatever it names.

A processor's step is any function of any Python module, by its dotted name. So the
names are read here, before LeRobot reads them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from rlco.errors import CheckpointError
from rlco.files import read_json

#: LeRobot's own steps in the processors of pi0.5 and SmolVLA.
STEPS = frozenset(
    {
        "absolute_actions_processor",
        "device_processor",
        "normalizer_processor",
        "pi05_prepare_state_tokenizer_processor_step",
        "relative_actions_processor",
        "rename_observations_processor",
        "smolvla_new_line_processor",
        "to_batch_processor",
        "tokenizer_processor",
        "unnormalizer_processor",
    }
)
_PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
#: LeRobot reads either: any name in Python, or one that it has registered.
_KEYS = ("class", "registry_name")
_TRUST = "trust_remote_code"
#: Of pi0-FAST; trusts the Python code beside its tokenizer by default.
_TRUSTING = "action_tokenizer_processor"


def check_steps(folder: Path, allow_code: Collection[str]) -> None:
    """Check what a checkpoint's processors would run.

    Args:
        folder: of the checkpoint. A processor that is missing names nothing.
        allow_code: names of steps that may run beside :data:`STEPS`.

    Raises:
        CheckpointError: a file cannot be read, or names anything else.
    """
    for file in (folder / name for name in _PROCESSORS):
        if not file.exists():
            continue
        steps = _read_steps(file)
        _check_trust(file, {"steps": steps})
        for name in (step[key] for step in steps for key in _KEYS if key in step):
            if name not in STEPS and name not in allow_code:
                raise CheckpointError(
                    f"{str(file)!r} names the step {name!r}, and LeRobot would run "
                    f"whatever that is; allowed are {', '.join(sorted(STEPS))}, and a "
                    "step of your own, if you trust its code, by "
                    f"allow_code=[{name!r}]."
                )


def check_config(file: Path, allow_code: Collection[str] = ()) -> None:
    """Check what the configuration of a policy or of a training would run.

    Args:
        file: LeRobot's ``config.json`` or ``train_config.json``.
        allow_code: tasks and domains ``MODULE:NAME``, and files of effects, that the
            environment of a training may name.

    Raises:
        CheckpointError: it holds no JSON object, trusts code from elsewhere, or names
            other Python.
    """
    advice = "copy the folder again, whole, or write it anew with LeRobot 0.6"
    content = dict(read_json(file, advice=advice, error=CheckpointError).content)
    _check_trust(file, content)
    env = content.get("env")
    for what in ("task", "domain", "effects_code"):
        named = env.get(what) if isinstance(env, dict) else None
        runs = isinstance(named, str) and (":" in named or what == "effects_code")
        if runs and named not in allow_code:
            raise CheckpointError(
                f"{str(file)!r} names the {what} {named!r}, Python that would be "
                "imported; take 'env' out of the file, or, if you trust that module, "
                f"give allow_code=[{named!r}]."
            )


def _read_steps(file: Path) -> list[dict[str, Any]]:
    """Return a processor's steps, each with a name that is text."""
    try:
        steps = read_json(file, error=CheckpointError).content.get("steps")
    except CheckpointError:
        steps = None
    if not isinstance(steps, list) or not all(map(_has_name, steps)):
        raise CheckpointError(
            f"{str(file)!r} holds no list of steps with names; copy the folder again, "
            "whole, or write it anew with LeRobot 0.6."
        )
    return steps


def _has_name(step: Any) -> bool:
    if not isinstance(step, dict):
        return False
    names = [step[key] for key in _KEYS if key in step]
    return bool(names) and all(isinstance(name, str) for name in names)


def _check_trust(file: Path, content: Any) -> None:
    place = next(_trusting(content), None)
    if place is not None:
        raise CheckpointError(
            f"{str(file)!r} has {place}, by which Python beside a tokenizer or a "
            "model would run; no option allows that: set it to false there, or take "
            "that entry out."
        )


def _trusting(content: Any, place: str = "") -> Iterator[str]:
    """Yield where in nested content code from elsewhere is trusted."""
    if isinstance(content, dict):
        if content.get("registry_name") == _TRUSTING:
            yield f"the step {_TRUSTING!r}, with {_TRUST} of its own"
        for key, value in content.items():
            if key == _TRUST and value:
                yield f"{place}{key}={value!r}"
            yield from _trusting(value, f"{place}{key}.")
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from _trusting(value, f"{place}{number}.")
