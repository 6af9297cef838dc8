"""Which searches are made at a joint, one after the other, by what the last one left.

The searches themselves are scripted: real ones take minutes to leave what is needed.
"""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_problems import last_state

from rlco.gap.search.fit import candidates_of
from rlco.gap.search.outside import free_joint
from rlco.gap.search.outside.course import PARTS, USUAL
from rlco.physics.effects import AppliedEffect

MISREADS, DRIFTS, KNOCKS = PARTS
GAIN = AppliedEffect("actuator_gain", "elbow", {"factor": 0.8})
DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.3})
COMPLIANCE = AppliedEffect("joint_compliance", "shoulder", {"compliance": 0.01})


def left(residual: float, *effects: AppliedEffect) -> Any:
    """What a search named, and the residual in units of the noise."""
    best = SimpleNamespace(
        effects=effects,
        names=frozenset(candidates_of(effects)),
        everything=np.full(4, residual),
    )
    return SimpleNamespace(best=best)


def test_what_is_found_at_the_joint_is_searched_beside_again_then_the_best_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = left(1.6, GAIN, COMPLIANCE), left(1.05, GAIN, COMPLIANCE)
    script = [*found, left(1.06, GAIN, COMPLIANCE)]
    asked = []

    def beside(at: Any, effects: Any, course: Any) -> Generator[Any, None, Any]:
        asked.append((effects, course))
        yield at.state
        return script.pop(0)

    parts = {MISREADS: 1.09, DRIFTS: 1.5, KNOCKS: 1.06}

    def freed(effects: Any, course: Any) -> Any:
        return SimpleNamespace(residual=lambda state, hypothesis: parts[course])

    monkeypatch.setattr(free_joint, "_beside", beside)
    monkeypatch.setattr(free_joint, "kind", lambda state: "named")
    at: Any = SimpleNamespace(state=left(20.0), joint="shoulder", freed=freed)
    last = last_state(free_joint._searched(at, (GAIN, DAMPING)))
    assert last.best.effects == (GAIN, COMPLIANCE)
    assert asked == [
        ((GAIN,), USUAL),  # a damping may have made up for what acts at the joint
        ((GAIN, COMPLIANCE), USUAL),  # since 1.6 is more than noise
        ((GAIN, COMPLIANCE), KNOCKS),  # which leave least of those that suffice
    ]
