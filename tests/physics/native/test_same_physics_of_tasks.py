"""Eight tasks move natively as robosuite moves them; rlco's in every domain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from physics_pairs import (
    KINDS,
    Difference,
    Pair,
    TaskPair,
    anchor,
    apart,
    contact_action,
    make_pair,
    random_action,
)
from stepping_cases import Watch

from rlco.physics.spec.domain import LOCKED, SIM, STAND_IN
from rlco.physics.spec.names import TASK_NAMES

pytestmark = pytest.mark.slow

# One with a joint and one with loose objects, and those that another author made.
PLACES = [("push_cube", SIM), ("open_drawer", STAND_IN), ("pick_and_place", STAND_IN)]
PLACES += [("Lift", SIM)]
EVERY = [(n, d) for d in (SIM, STAND_IN, LOCKED) for n in TASK_NAMES]
EVERY += [(n, SIM) for n in ("NutAssembly", "Stack", "Door")]
MORE = [place for place in EVERY if place not in PLACES]
# What draws actions, how many episodes are played, and how many steps of each.
MOTIONS = {"random": (random_action, 2, 30), "contact": (contact_action, 1, 70)}


@dataclass(frozen=True)
class Played:
    """Control steps, each from robosuite's state.

    Attributes:
        apart: The largest difference of a coordinate, by arithmetic, shape (S,).
        differences: The other differences, by arithmetic, one a step.
        alone: Whether the robot touched nothing, itself included, shape (S,).
        others: Whether it touched anything but itself, shape (S,).
    """

    apart: dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]
    differences: dict[str, list[Difference]]
    alone: np.ndarray[tuple[int], np.dtype[np.bool_]]
    others: np.ndarray[tuple[int], np.dtype[np.bool_]]


@pytest.fixture(
    scope="module",
    params=[*PLACES, *(pytest.param(one, marks=pytest.mark.thorough) for one in MORE)],
    ids=lambda place: f"{place[0]}-{place[1].name}",
)
def pair(request: pytest.FixtureRequest) -> Pair:
    name, domain = request.param
    if (name, domain) == ("pick_and_place", STAND_IN):
        return TaskPair(name, domain=domain, variation="distractors")
    return make_pair(name, domain=domain)


@pytest.fixture(scope="module")
def watch(pair: Pair) -> Watch:
    return Watch(pair.env)


@pytest.fixture(scope="module")
def played(pair: Pair, watch: Watch) -> dict[str, Played]:
    """Play random actions, and actions that seek contact."""
    return {motion: play(pair, watch, motion) for motion in MOTIONS}


def play(pair: Pair, watch: Watch, motion: str) -> Played:
    act, episodes, length = MOTIONS[motion]
    distances: dict[str, list[float]] = {kind: [] for kind in KINDS}
    differences: dict[str, list[Difference]] = {kind: [] for kind in KINDS}
    alone, others = [], []
    for seed in range(episodes):
        pair.start(seed)
        assert all(apart(pair, kind) == 0.0 for kind in KINDS)
        rng = np.random.default_rng(seed)
        for _ in range(length):
            anchor(pair)
            action = act(pair, rng)
            watch.clear()
            found = pair.step(action)
            for kind in KINDS:
                distances[kind].append(apart(pair, kind))
                differences[kind].append(found[kind])
            alone.append(not watch.touched)
            others.append(watch.touched_others)
    arrays = {kind: np.array(distance) for kind, distance in distances.items()}
    return Played(arrays, differences, np.array(alone), np.array(others))


def test_exact_steps_equal_robosuites_to_the_last_bit(
    played: dict[str, Played],
) -> None:
    for steps in played.values():
        assert steps.apart["exact"].max() == 0.0
        for it in steps.differences["exact"]:
            assert (it.reward, it.flag, it.seen) == (0.0, False, 0.0)
    assert played["contact"].others.any()


def test_fast_steps_differ_by_rounding_but_at_contacts(
    played: dict[str, Played],
) -> None:
    for steps in played.values():
        distance = steps.apart["fast"]
        rewards = np.array([it.reward for it in steps.differences["fast"]])
        # A gain wrong by one part in 1e13 already shows.
        assert 0.0 < np.median(distance) <= 1e-15
        assert distance[steps.alone].max() <= 1e-14
        assert rewards[steps.alone].max() <= 1e-12
        # Contacts enlarge the rounding: MuJoCo's collision branches on it.
        assert distance.max() <= 1e-2
        assert not any(it.flag for it in steps.differences["fast"])
    assert (played["random"].apart["fast"] <= 1e-9).mean() >= 0.95
    # The pads of closed fingers are boxes pressed onto each other: three experts hold
    # them so, and are in such a contact in every step.
    assert (played["contact"].apart["fast"] <= 1e-9).mean() >= 0.5


def test_an_open_loop_in_the_air_stays_with_robosuite(pair: Pair, watch: Watch) -> None:
    for seed in (7, 8):
        pair.start(seed)
        rng = np.random.default_rng(seed)
        watch.clear()
        for step in range(20):
            action = rng.uniform(-0.4, 0.4, 7)
            action[2] = 0.6 if step < 8 else 0.0  # up, away from things
            action[6] = -1.0  # fingers that stay open do not touch either
            pair.step(action)
            assert apart(pair, "exact") == 0.0
            assert apart(pair, "fast") <= 1e-12
        assert not watch.touched_others
