"""A closed environment is freed at once, and the heap is not searched for it."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.faster.release import release
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import SIM, STAND_IN
from rlco.physics.tasks.named_task import check_domains
from rlco.physics.tasks.push_cube import TASK

Watch = list[weakref.ref[Any]]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    """Watch the environments that are made, where no garbage is collected."""
    found: Watch = []
    first = Tabletop.__init__

    def watched(env: Tabletop, *args: Any, **options: Any) -> None:
        first(env, *args, **options)
        found.extend([weakref.ref(env), weakref.ref(env.sim)])
        found.append(weakref.ref(env.robots[0]))

    def refuse() -> int:
        raise RuntimeError("the heap is searched")

    gc.collect()
    monkeypatch.setattr(Tabletop, "__init__", watched)
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
    made.extend([weakref.ref(env), weakref.ref(env.sim), weakref.ref(env.robots[0])])
    release(env)
    del env
    assert [ref() for ref in made] == [None] * 3


@pytest.mark.parametrize(
    "make",
    [
        lambda: NativeStepper(TASK, SIM, num_envs=2, threads=1),
        lambda: NativeStepper(TASK, STAND_IN, num_envs=2, threads=1),
        lambda: check_domains("push_cube", [replace(STAND_IN, name="mine")]),
    ],
    ids=["sim", "stand_in", "check_domains"],
)
def test_what_a_model_was_read_from_is_freed(
    made: Watch, make: Callable[[], Any]
) -> None:
    kept = make()
    assert [ref() for ref in made] == [None] * 3
    del kept
