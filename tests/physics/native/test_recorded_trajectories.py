"""Both domains move as they did when their trajectories were recorded."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_trajectories import BACKENDS, DOMAINS, FILE, fingerprint, played

from rlco.physics.spec.names import TASK_NAMES

MORE = [name for name in TASK_NAMES if name not in ("push_cube", "open_drawer")]


@pytest.fixture(scope="module")
def recorded() -> dict[str, np.ndarray]:
    with np.load(FILE) as file:
        return dict(file)


def _part(recorded: dict[str, np.ndarray], lead: str) -> dict[str, np.ndarray]:
    return {k.removeprefix(lead): v for k, v in recorded.items() if k.startswith(lead)}


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize(
    "task",
    [
        *("push_cube", "open_drawer"),
        *(pytest.param(one, marks=pytest.mark.thorough) for one in MORE),
    ],
)
def test_a_domain_moves_as_it_was_recorded(
    recorded: dict[str, np.ndarray], task: str, domain: str, backend: str
) -> None:
    starts = _part(recorded, f"{task}/start/")
    actions = recorded[f"{task}/actions"].astype(np.float64)
    found = played(task, domain, backend, starts, actions)
    native = _part(recorded, f"{task}/{domain}/native/")
    robosuite = _part(recorded, f"{task}/{domain}/robosuite/")
    expected = {"native": native, "robosuite": robosuite}[backend]
    assert set(found) == set(expected)
    same = str(recorded["fingerprint"]) == fingerprint()
    for name, value in found.items():
        if same:
            np.testing.assert_array_equal(value, expected[name], err_msg=name)
            continue
        # Another processor or library rounds otherwise, and contacts enlarge that. How
        # much is known from the two backends, which round differently too.
        enlarged = np.abs(native[name] - robosuite[name])
        axes = tuple(range(2, enlarged.ndim))
        allowed = 1e-9 + 1e5 * enlarged.max(axis=axes, keepdims=True, initial=0.0)
        assert (np.abs(value - expected[name]) <= allowed).all(), name
