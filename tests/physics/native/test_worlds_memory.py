"""More worlds than fit into memory are refused, before any is made."""

from __future__ import annotations

import pytest

from rlco.errors import DataError
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM
from rlco.physics.tasks.push_cube import TASK


def test_more_worlds_than_fit_into_memory_are_refused() -> None:
    with pytest.raises(DataError, match=r"num_envs=1000000000 states of this model"):
        NativeStepper(TASK, SIM, num_envs=10**9)
