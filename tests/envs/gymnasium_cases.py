"""What the tests of the Gymnasium environments share."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from rlco.errors import RenderingError

ID = "rlco.physics.tasks.registration:rlco/PushCube-v0"


def make(**options: Any) -> Any:
    """Return the environment, or skip the test where frames cannot be rendered."""
    try:
        return gymnasium.make(ID, **options)
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")


def actions(steps: int, seed: int = 0) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (steps, 7)).astype(np.float32)
