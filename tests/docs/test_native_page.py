"""The page on native stepping shows what runs."""

from __future__ import annotations

import numpy as np
from pages import run_python


def test_copies_that_differ_run_as_copied_and_differ() -> None:
    made = run_python("native.md", "## Worlds that differ")
    stepper = made["stepper"]
    masses = [stepper.model_of(n).body_mass.sum() for n in (0, 63)]
    np.testing.assert_allclose(masses[1] / masses[0], 4.0)
    assert set(np.unique(stepper.worlds.memory.delay)) == {0, 1, 2}
