"""One robosuite environment whose Python evaluates, and resets, the states of worlds.

Reward, success, observations and initial states of any robosuite task are Python that
reads ``env.sim.data``. This name is pointed at one world's state after another, so that
robosuite's own code computes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.mj.model_struct import array_fields
from rlco.physics.robosuite.faster.contact_check import ContactCheck
from rlco.physics.robosuite.faster.fast_reset import FastReset, make_reset_cheap
from rlco.physics.robosuite.global_random import seed_all, seeded
from rlco.physics.robosuite.read_control import refuse_unsupported
from rlco.physics.robosuite.robosuite_api import (
    NO_CORRUPTION,
    NO_DELAY,
    NO_FILTER,
    ManipulationEnv,
)

Array = NDArray[np.float64]
Cache = dict[str, Any]
# Python that robosuite's control step runs besides reward and observables.
_STEP_HOOKS = (
    "step",
    "_pre_action",
    "_post_action",
    "_get_observations",
    "_update_observables",
    "update_state",
)


class RobosuiteSource:
    """robosuite's reset, reward, success and observations for any world's state.

    Args:
        env: A robosuite environment, reset once; it cannot step itself any more.
        observations: Names of observables, or of modalities with ``-state`` appended,
            as in robosuite's own observations; None: all that are active.

    Attributes:
        env: The environment.
        columns: Slice of each observation in the result of `observe`.
        lags: Whether an observable reads a measurement of the previous control step,
            so that it must be measured after every one.
        reset_fields: Arrays of the model that a reset changes.

    Raises:
        RlcoError: If the environment uses an unsupported feature, which is named.
        UnknownNameError: If there is no such observation.
    """

    def __init__(self, env: Any, observations: Sequence[str] | None = None) -> None:
        _refuse(env)
        self.env = env
        self._measured: list[tuple[str, Callable[[Cache], Any]]] = []
        self.reset_fields = _fields_that_change(env)
        self.lags = False
        self.columns: dict[str, NDArray[np.int64]] = {}
        self._choose(observations)
        self._refuse_views()
        self._robots = [FastReset(robot) for robot in env.robots]
        make_reset_cheap(env)
        env.check_contact = ContactCheck(env)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model; a reset writes `reset_fields` into it."""
        return self.env.sim.model._model

    def look_at(self, data: mujoco.MjData) -> None:
        """Make robosuite's code read this state from now on."""
        self.env.sim.data._data = data

    def place(self, seed: int) -> None:
        """Start an episode in the current state, which must be the model's default.

        Positions are set, but nothing that depends on them is computed.

        Args:
            seed: Of the global generators that robosuite draws from; they are restored
                afterwards.
        """
        seed_all(seed)
        robots = self.env.robots
        self.env.robots = self._robots
        try:
            self.env._reset_internal()
        finally:
            self.env.robots = robots

    def observe(self, cache: Cache) -> Array:
        """Return the observations of the current state, one row.

        Args:
            cache: robosuite's cache of earlier measurements, one per world.
        """
        for name, sensor in self._measured:
            value = np.array(sensor(cache))
            cache[name] = value[0] if value.shape == (1,) else value
        return np.concatenate([np.ravel(cache[name]) for name in self._active])

    def _refuse_views(self) -> None:
        """Refuse an observable that keeps references to the arrays of one state."""
        own = self.env.sim.data._data
        clinging = []
        other = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, other)
        moved = np.random.default_rng(0).standard_normal(other.xpos.size)
        for state in (
            "xpos",
            "xquat",
            "xmat",
            "geom_xpos",
            "geom_xmat",
            "site_xpos",
            "site_xmat",
            "qpos",
            "qvel",
        ):
            array = getattr(own, state)
            before = array.copy()
            self.look_at(other)
            first = self.observe({})
            array += np.resize(moved, array.shape)
            if not np.array_equal(first, self.observe({}), equal_nan=True):
                clinging.append(state)
            array[:] = before
        self.look_at(own)
        if clinging:
            raise RlcoError(
                f"{type(self.env).__name__}: the native backend does not support "
                f"observables that hold on to the arrays {clinging} of one state; read "
                "sim.data in the sensor, or give backend='robosuite'."
            )

    def _choose(self, wanted: Sequence[str] | None) -> None:
        """Determine which sensors the requested observations need, and their order."""
        found = {k: o for k, o in self.env._observables.items() if o.is_enabled()}
        sensors = {name: observable._sensor for name, observable in found.items()}
        active = [name for name, observable in found.items() if observable.is_active()]
        groups: dict[str, list[str]] = {}
        for name in active:
            groups.setdefault(f"{found[name].modality}-state", []).append(name)
        known = [*active, *groups]
        for name in wanted or ():
            if name not in known:
                raise UnknownNameError("observation", name, known)
        wanted = known if wanted is None else wanted
        reads, self.lags = _dependencies(sensors)
        needed: set[str] = set()
        todo = [n for name in wanted for n in groups.get(name, [name])]
        self._active = [name for name in active if name in todo]
        while todo:
            name = todo.pop()
            if name not in needed:
                needed.add(name)
                todo += reads[name]
        self._measured = [(k, sensor) for k, sensor in sensors.items() if k in needed]
        cache: Cache = {}
        self.observe(cache)
        end = 0
        for name in self._active:
            size = np.size(cache[name])
            self.columns[name] = np.arange(end, end + size)
            end += size
        for group, names in groups.items():
            if group in wanted:
                self.columns[group] = np.concatenate([self.columns[n] for n in names])
        self.columns = {k: v for k, v in self.columns.items() if k in wanted}


class _Reads(dict[str, Any]):
    """A cache that records which of its entries are read."""

    def __init__(self) -> None:
        super().__init__()
        self.read: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        self.read.add(key)
        return super().__getitem__(key)


def _dependencies(
    sensors: dict[str, Callable[[Cache], Any]],
) -> tuple[dict[str, list[str]], bool]:
    """Return the measurements that each sensor reads, and whether any is an old one."""
    cache, reads = _Reads(), {name: set[str]() for name in sensors}
    written: dict[str, str] = {}  # including side effects of sensors
    lags = False
    for turn in range(3):
        fresh: set[str] = set()
        for name, sensor in sensors.items():
            before = {k: id(v) for k, v in cache.items()}
            cache.read = set()
            cache[name] = np.array(sensor(cache))
            reads[name] |= {written.get(k, k) for k in cache.read} & set(sensors)
            lags |= turn == 2 and not (cache.read <= fresh)
            changed = {k for k, v in cache.items() if before.get(k) != id(v)}
            written |= dict.fromkeys(changed, name)
            fresh |= changed
    return {name: sorted(found - {name}) for name, found in reads.items()}, lags


def _refuse(env: Any) -> None:
    """Refuse features of robosuite's Python that are not supported."""
    name = type(env).__name__
    if not isinstance(env, ManipulationEnv):
        raise RlcoError(
            f"{name} is not a manipulation environment of robosuite; give the one that "
            "robosuite.make returns, without wrappers."
        )
    refuse_unsupported(env)
    for what, found, advice in (
        ("hard_reset=True", env.hard_reset, "give hard_reset=False"),
        ("use_camera_obs=True", env.use_camera_obs, "give use_camera_obs=False"),
        (
            "single_object_mode=1",
            getattr(env, "single_object_mode", 0) == 1,
            "give the mode 2 and the object's type",
        ),
        *(
            (f"its own {hook}()", _overrides(env, hook), "do that in reward()")
            for hook in _STEP_HOOKS
        ),
        *(
            (
                f"noise, delay or another rate of the observable {k!r}",
                not _plain(o, env),
                "leave its sensor as it is",
            )
            for k, o in env._observables.items()
        ),
    ):
        if found:
            raise RlcoError(
                f"{name}: the native backend does not support {what}; {advice}, or "
                "give backend='robosuite'."
            )


def _overrides(env: Any, method: str) -> bool:
    ours = getattr(type(env), method)
    return ours is not getattr(ManipulationEnv, method) or method in vars(env)


def _plain(observable: Any, env: Any) -> bool:
    same_rate = observable._sampling_timestep == 1.0 / env.control_freq
    return (
        observable._corrupter is NO_CORRUPTION
        and observable._filter is NO_FILTER
        and observable._delayer is NO_DELAY
        and same_rate
    )


def _fields_that_change(env: Any) -> tuple[str, ...]:
    """Return the arrays of the model that resets write, except colours."""
    names = [n for n in array_fields() if not n.endswith("_rgba")]
    model = env.sim.model._model
    read = []
    for seed in (0, 1):
        with seeded(seed):
            env.reset()
        read.append([getattr(model, name).copy() for name in names])
    return tuple(
        name
        for name, one, other in zip(names, *read, strict=True)
        if not np.array_equal(one, other)
    )
