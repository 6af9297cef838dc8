"""N worlds of one compiled model under one controller, stepped in threads."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.files.sizes import check_held
from rlco.physics.mj.libmujoco import address_of
from rlco.physics.mj.model_struct import ModelCopy, array_fields, reserve_memory
from rlco.physics.native.processors import available_processors
from rlco.physics.native.world_checks import (
    check_threads,
    checked_delay,
    checked_fields,
    checked_gains,
    checked_worlds,
    is_derived_from,
)
from rlco.physics.native.world_memory import FIELDS, Memory
from rlco.physics.robosuite.drawn_models import DrawnModels
from rlco.physics.spec.control import Array, Control, Integers

RESERVED = 16 << 20  # address space for each world's contacts [bytes]


class Worlds:
    """N states of a model, each with its own model where it differs.

    Args:
        model: The compiled model; copied.
        control: The arm's controller.
        gains: Stiffness and damping of the controller, each shape (D,).
        num_envs: Number of worlds N.
        threads: Python threads, at most `num_envs`; by default one for each processor
            that this process may run on.
        longest_delay: Maximum delay in control steps, beyond that of `control`.
        controller_model: The controller's own model, where it is another.
        drawn: Parameter sets that `draw` may give to a world; None: none.

    Raises:
        RlcoError: If `threads` is less than 1, or the memory too small for so many.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        control: Control,
        gains: tuple[Array, Array],
        *,
        num_envs: int,
        threads: int | None,
        longest_delay: int = 0,
        controller_model: mujoco.MjModel | None = None,
        drawn: DrawnModels | None = None,
    ) -> None:
        check_threads(threads)
        self.control = control
        self.num_envs = num_envs
        self.model = _own(model)
        check_held(
            num_envs * mujoco.MjData(self.model).nbuffer,
            f"num_envs={num_envs} states of this model",
            "give fewer",
        )
        self.data = [mujoco.MjData(self.model) for _ in range(num_envs)]
        fields = observed = _addresses(self.data)
        self.observed = self.data
        if controller_model is not None:
            self._controller_model = _own(controller_model)
            self.observed = [
                mujoco.MjData(self._controller_model) for _ in range(num_envs)
            ]
            observed = _addresses(self.observed)
            acting = control.acting._replace(
                controller_model=self._controller_model._address
            )
            self.control = control._replace(acting=acting)
        fingers, pending = (
            control.finger_ctrl.size,
            longest_delay + control.acting.room,
        )
        self.memory = Memory(
            models=np.full(num_envs, self.model._address, dtype=np.int64),
            fields=fields,
            observed=observed,
            posture=np.zeros((num_envs, control.arm_dof.size)),
            grip=np.zeros((num_envs, fingers)),
            stiffness=np.tile(gains[0], (num_envs, 1)),
            damping=np.tile(gains[1], (num_envs, 1)),
            delay=np.zeros(num_envs, dtype=np.int64),
            pending=np.zeros((num_envs, pending, control.action_size)),
            passed=np.zeros(num_envs, dtype=np.int64),
            seed=np.zeros(num_envs, dtype=np.int64),
            broken=np.zeros(num_envs, dtype=np.bool_),
            fresh=np.zeros(num_envs, dtype=np.bool_),
            first_mass=np.zeros((num_envs, control.arm_dof.size, control.arm_dof.size)),
            first_jacobian=np.zeros((num_envs, 6, control.arm_dof.size)),
            goal=np.zeros((num_envs, max(3, control.inputs.shape[1]))),
            goal_rotation=np.zeros((num_envs, 3, 3)),
            clock=np.zeros(num_envs, dtype=np.int64),
            action=np.zeros((num_envs, control.inputs.shape[1] + 1)),
            unread=np.zeros(num_envs, dtype=np.bool_),
            ctrl=np.zeros((num_envs, control.nu)),
            friction=np.zeros(num_envs, dtype=np.int64),
            coulomb=np.zeros((num_envs, control.nv)),
        )
        self._drawn = drawn
        # A world's own control, where it has a parameter set of its own.
        self._controls: dict[int, Control] = {}
        self._models: dict[int, ModelCopy] = {}
        self.restore_models(np.arange(num_envs))
        self._compiler: tuple[mujoco.MjModel, mujoco.MjData] | None = None
        self._compiled_arrays: set[str] = set()
        self.threads = min(threads or available_processors(), num_envs)
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None

    def run(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Run a compiled loop over all worlds, in threads."""
        self.run_over(kernel, self.num_envs, *arguments)

    def run_controlled(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Run ``kernel(first, last, control, memory, *arguments)`` over all worlds."""
        if not self._controls:
            self.run(kernel, self.control, self.memory, *arguments)
            return

        def run_each(first: int, last: int) -> None:
            for number in range(first, last):
                control = self.control_of(number)
                kernel(number, number + 1, control, self.memory, *arguments)

        self.run(run_each)

    @property
    def draws(self) -> bool:
        """Whether the worlds have parameter sets to draw from."""
        return self._drawn is not None

    def control_of(self, number: int) -> Control:
        """Return the controller of one world, with the effects that act there."""
        return self._controls.get(number, self.control)

    def reported(self, which: Integers, columns: Integers) -> Array:
        """Return factors and offsets of encoder reports, (2, R, columns)."""
        rows = [
            self.control_of(number).acting.reported[:, columns]
            for number in which.tolist()
        ]
        return np.stack(rows, axis=1)

    def run_over(
        self, kernel: Callable[..., None], count: int, *arguments: Any
    ) -> None:
        """Run a compiled loop, ``kernel(first, last, *arguments)``, over [0, count)."""
        if self._pool is None or count <= 1:
            kernel(0, count, *arguments)
            return
        # Several ranges per thread: worlds in contact take longer than others.
        parts = min(count, 4 * self.threads)
        edges = np.linspace(0, count, parts + 1).astype(int).tolist()
        jobs = [
            self._pool.submit(kernel, first, last, *arguments)
            for first, last in itertools.pairwise(edges)
        ]
        try:
            for job in jobs:
                job.result()
        except BaseException:
            wait(jobs)  # what raised is heard when no world is stepped any more
            raise

    def forget(self, which: Integers) -> None:
        """Drop pending commands and divergences of the worlds `which`."""
        memory = self.memory
        memory.pending[which] = memory.action[which] = 0.0
        memory.broken[which] = memory.unread[which] = False
        memory.clock[which] = 0
        if self.control.acting.forces.friction.rows.size:
            for number in which.tolist():
                self._models[number].set_array(
                    "dof_frictionloss", memory.coulomb[number]
                )

    # -- Differences between worlds ----------------------------------------------

    def draw(self, which: Integers, rows: Sequence[int]) -> None:
        """Give each of the worlds `which` a parameter set, until the next draw.

        Their pending commands are dropped, so that a reset has to follow.

        Raises:
            RlcoError: If there are no parameter sets.
        """
        if self._drawn is None:
            raise RlcoError(
                "the domain has no parameter sets to draw from; give an effects.yaml "
                "with a sample, or draw none."
            )
        for number, row in zip(which.tolist(), rows, strict=True):
            drawn = self._drawn[row]
            acting = drawn.corrected.acting(self.control.substeps)._replace(
                controller_model=self.control.acting.controller_model
            )
            self._controls[number] = self.control._replace(acting=acting)
            self._reserve(acting.room + int(self.memory.delay[number]))
            own = self._own_model(number)
            own.become(drawn.values)
            if acting.forces.friction.rows.size:
                self._keep_friction(number, own)

    def _reserve(self, longest: int) -> None:
        """Make room for pending commands, at least `longest` of each world."""
        pending = self.memory.pending
        if longest > pending.shape[1]:
            grown = np.zeros((self.num_envs, longest, self.control.action_size))
            grown[:, : pending.shape[1]] = pending
            self.memory = self.memory._replace(pending=grown)

    def _keep_friction(self, number: int, own: ModelCopy) -> None:
        """Let friction laws write into a world's own model, on top of its friction."""
        values = own.arrays.get("dof_frictionloss", self.model.dof_frictionloss).copy()
        own.set_array("dof_frictionloss", values)
        self.memory.friction[number] = address_of(own.arrays["dof_frictionloss"])
        self.memory.coulomb[number] = values

    def randomise(
        self,
        which: Integers | Sequence[int],
        fields: Mapping[str, NDArray[Any]] | None = None,
        *,
        stiffness: NDArray[Any] | float | None = None,
        damping: NDArray[Any] | float | None = None,
        command_delay: NDArray[Any] | int | None = None,
    ) -> None:
        """Change only the worlds `which`, until changed again.

        Args:
            which: Indices of worlds, shape (R,), each once.
            fields: Arrays of the model by MuJoCo's name (``body_mass``), of the
                model's shape, or with a leading axis (R,) of one value per world; those
                of `world_checks.PATCHABLE`, among them ``headlight``, its ambient,
                diffuse and specular colour (3, 3). Quantities that MuJoCo derives from
                them (``mj_setConst``) are updated.
            stiffness: The controller's: a number, one per world (R,), or one per axis,
                broadcast to (R, D). Damping keeps its ratio to critical damping where
                it is not given.
            damping: The controller's, in the same shapes.
            command_delay: Control steps between a command and its execution,
                broadcast to (R,); pending commands are dropped.

        Raises:
            RlcoError: If a name, a shape or a value is not allowed, or worlds have
                parameter sets of their own; nothing has changed then.
        """
        if self._drawn is not None:
            raise RlcoError(
                "worlds that draw parameter sets cannot be randomised besides, since "
                "each reset draws anew; leave out the domain's sample."
            )
        # Everything is checked before anything changes.
        rows = checked_worlds(which, self.num_envs)
        count, axes = rows.size, self.memory.stiffness.shape[1]
        values = checked_fields(self.model, fields or {}, count)
        stiff = checked_gains("stiffness", stiffness, count, axes, zero=False)
        damp = checked_gains("damping", damping, count, axes, zero=True)
        delay = checked_delay(command_delay, count)
        if delay is not None and self.control.acting.random.size:
            raise RlcoError(
                "command_delay= sets the whole delay of a world, but the domain's "
                "random_delay draws one for each command; leave out one of them."
            )
        if values:
            derive = any(map(is_derived_from, values))
            self.patch_model(rows, values, derive=derive)
        self._set_gains(rows, stiff, damp)
        if delay is not None:
            self._set_delay(rows, delay)

    def patch_model(
        self, which: Integers, values: Mapping[str, NDArray[Any]], *, derive: bool
    ) -> None:
        """Give the worlds `which` their own values of arrays of the model, unchecked.

        Args:
            which: Indices of worlds, shape (R,).
            values: Arrays by MuJoCo's name, of the model's shape with a leading axis
                (R,).
            derive: Recompute quantities that MuJoCo derives from masses and the like
                (``mj_setConst``).
        """
        for row, number in enumerate(which.tolist()):
            own = self._own_model(number)
            for name, value in values.items():
                own.set_array(name, value[row])
                if name == "dof_frictionloss":
                    self.memory.coulomb[number] = own.arrays[name]
            if derive:
                self._derive(own)

    def model_of(self, number: int) -> mujoco.MjModel:
        """Return one world's model for MuJoCo's Python functions.

        It is valid until the next call; the common model if the world has no other.
        """
        if number not in self._models:
            return self.model
        return self._compiled(self._models[number])[0]

    def _set_gains(
        self, which: Integers, stiffness: Array | None, damping: Array | None
    ) -> None:
        """Set the controller's gains; damping keeps its ratio where it is not given."""
        memory = self.memory
        if stiffness is not None:
            ratio = memory.damping[which] / np.sqrt(memory.stiffness[which])
            memory.stiffness[which] = stiffness
            memory.damping[which] = ratio * np.sqrt(stiffness)
        if damping is not None:
            memory.damping[which] = damping

    def _set_delay(self, which: Integers, delay: Integers) -> None:
        """Set the command delay [control steps]; pending commands are dropped."""
        longest = max(int(delay.max(initial=0)), self.memory.pending.shape[1])
        pending = np.zeros((self.num_envs, longest, self.control.action_size))
        pending[:, : self.memory.pending.shape[1]] = self.memory.pending
        pending[which] = 0.0
        self.memory = self.memory._replace(pending=pending)
        self.memory.delay[which] = delay - self.control.acting.whole

    def restore_models(self, which: Integers) -> None:
        """Restore the common model of the worlds `which`."""
        for number in which.tolist():
            self.memory.models[number] = self.model._address
            self._models.pop(number, None)
            if self.control.acting.forces.friction.rows.size:
                # Friction that changes from step to step is a world's own.
                self._keep_friction(number, self._own_model(number))

    def _own_model(self, number: int) -> ModelCopy:
        if number not in self._models:
            self._models[number] = ModelCopy(self.model)
            self.memory.models[number] = self._models[number].address
        return self._models[number]

    def _compiled(self, own: ModelCopy) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return a complete model with a world's arrays, and data to compute with."""
        if self._compiler is None:
            model = copy.copy(self.model)
            self._compiler = model, mujoco.MjData(model)
        model = self._compiler[0]
        for name in self._compiled_arrays - set(own.arrays):
            getattr(model, name)[:] = getattr(self.model, name)
        for name, value in own.arrays.items():
            getattr(model, name)[:] = value
        own.give_values(model)
        self._compiled_arrays = set(own.arrays)
        return self._compiler

    def _derive(self, own: ModelCopy) -> None:
        model, data = self._compiled(own)
        mujoco.mj_setConst(model, data)
        for name in array_fields():
            value = getattr(model, name)
            changed = not np.array_equal(value, getattr(self.model, name))
            if changed or name in own.arrays:  # or it was changed before
                own.set_array(name, value)
        self._compiled_arrays = set(own.arrays)
        own.take_statistics(model)


def _own(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model that keeps diverged states and stores little."""
    own: mujoco.MjModel = copy.copy(model)
    # Diverged states must stay visible instead of being reset.
    own.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    reserve_memory(own, min(RESERVED, own.narena))
    return own


def _addresses(data: list[mujoco.MjData]) -> Integers:
    """Return the addresses of each state and its arrays, (N, 1 + FIELDS)."""
    rows = [[d._address, *(address_of(getattr(d, n)) for n in FIELDS)] for d in data]
    return np.array(rows, dtype=np.int64)
