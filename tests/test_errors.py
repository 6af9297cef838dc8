"""Errors say in another process what they say where they were raised."""

from __future__ import annotations

import pickle

import pytest

from rlco.errors import (
    ConfigError,
    DataError,
    NoSignalError,
    OutputExistsError,
    RenderingError,
    RlcoError,
    SimulationError,
    UnknownNameError,
)
from rlco.physics.effects.apply import EffectError


@pytest.mark.parametrize(
    "error",
    [
        ConfigError(["lr is below 0", "seed is none"]),
        DataError("file 'a' is missing; copy it again."),
        EffectError("payload", "hand", "mass is nan", "give a finite number"),
        NoSignalError(0, 8),
        OutputExistsError("out", resumable=True),
        RenderingError("egl", "no library"),
        SimulationError("push_cube", [1, 2]),
        UnknownNameError("task", "push", ["push_cube"]),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_is_the_same_in_another_process(error: RlcoError) -> None:
    sent = pickle.loads(pickle.dumps(error))
    assert type(sent) is type(error)
    assert (str(sent), vars(sent)) == (str(error), vars(error))
