"""A closed environment is freed at once, and the heap is not searched for it."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from rlco.gap.demos.replay.plants import Plants
from rlco.gap.model import load_model
from rlco.physics.effects import AppliedEffect
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.faster.release import release
from rlco.physics.robosuite.robosuite_api import ManipulationEnv
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import SIM, STAND_IN, Domain
from rlco.physics.tasks.named_task import _of_robosuite, check_domains
from rlco.physics.tasks.push_cube import TASK

Watch = list[weakref.ref[Any]]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    """Watch the environments that are made, where no garbage is collected."""
    found: Watch = []
    first = ManipulationEnv.__init__

    def watched(env: Any, *args: Any, **options: Any) -> None:
        first(env, *args, **options)
        found.extend([weakref.ref(one) for one in (env, env.sim, env.robots[0])])

    def refuse() -> int:
        raise RuntimeError("the heap is searched")

    gc.collect()
    monkeypatch.setattr(ManipulationEnv, "__init__", watched)
    monkeypatch.setattr(gc, "collect", refuse)
    gc.disable()
    yield found
    gc.enable()


@pytest.mark.parametrize("domain", [SIM, STAND_IN], ids=["sim", "stand_in"])
@pytest.mark.parametrize("image_size", [None, (32, 32)], ids=["poses", "images"])
def test_a_closed_environment_is_freed(
    made: Watch, rendering: None, domain: Any, image_size: Any
) -> None:
    env = Tabletop(TASK, domain, image_size=image_size)
    env.reset()
    env.close()
    env.close()
    del env
    assert [ref() for ref in made] == [None] * 3


def test_one_of_robosuites_own_is_freed(made: Watch) -> None:
    env = make_plain("Lift")
    env.reset()
    release(env)
    del env
    assert [ref() for ref in made] == [None] * 3


DAMPING = AppliedEffect("viscous_damping", "joint4", {"damping": 40.0})


@pytest.mark.parametrize(
    "make",
    [
        lambda: NativeStepper(TASK, SIM, num_envs=2, threads=1),
        lambda: NativeStepper(TASK, STAND_IN, num_envs=2, threads=1),
        lambda: Plants(TASK, STAND_IN),
        lambda: load_model("robosuite:push_cube"),
        lambda: load_model("robosuite:Lift"),
        lambda: check_domains("push_cube", [replace(STAND_IN, name="mine")]),
        lambda: check_domains("robosuite:Lift", [Domain("damped", (DAMPING,))]),
        lambda: _of_robosuite.__wrapped__("Stack"),
    ],
    ids=[
        *("sim", "stand_in", "plants", "model", "model of robosuite's", "domains"),
        *("domains of robosuite's", "description of robosuite's"),
    ],
)
def test_what_was_made_to_be_read_is_freed(
    made: Watch, make: Callable[[], Any]
) -> None:
    kept = make()
    assert [ref() for ref in made] == [None] * 3
    del kept
