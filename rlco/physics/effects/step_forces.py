"""Forces that effects add at each physics step, by one law in every backend.

The rollouts that identify an effect, the native stepper, the robosuite backend, the
torque log and the servo bench all evaluate the laws here. A law is a function of
numbers, compiled to machine code. A step holds its address, so a user-defined effect
acts in loops that were compiled before it.

The order of a step in every backend:

1. `set_friction`, before positions and velocities are evaluated: friction as MuJoCo's
   ``frictionloss``, which its solver applies against the motion, never beyond what
   stops it. The torques are those at the end of the previous step, as in friction
   models on top of an engine (BAM, arXiv 2410.08650).
2. Commands are set and MuJoCo computes the actuators' forces.
3. `set_torques`, before the acceleration: torques that depend on the actuators' forces
   in the same step.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from inspect import isfunction
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import cfunc, njit, types
from numba.core.errors import NumbaError
from numba.extending import intrinsic
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.effects.effect import Array, Law

Integers = NDArray[np.int64]
_SIGNATURE = types.float64(*[types.float64] * 4, types.CPointer(types.float64))


class Laws(NamedTuple):
    """Laws of one kind, each at one joint, R of them with at most P parameters."""

    rows: Integers  # address of the law, degree of freedom, address in qpos; (R, 3)
    values: Array  # parameter values of the effects, (R, P)


class StepForces(NamedTuple):
    """Forces at each physics step that MJCF cannot express, for compiled loops."""

    friction: Laws
    torque: Laws


class LawAt(NamedTuple):
    """A law at a joint, with its parameter values."""

    law: Law
    dof: int
    place: int  # address in qpos
    values: Array


def table_of(laws: Iterable[LawAt]) -> Laws:
    """Return laws in the form that compiled loops read.

    Raises:
        RlcoError: If a law cannot be compiled.
    """
    laws = list(laws)
    rows = np.zeros((len(laws), 3), dtype=np.int64)
    values = np.zeros((len(laws), max([1, *(len(one.values) for one in laws)])))
    for number, one in enumerate(laws):
        rows[number] = address_of_law(one.law), one.dof, one.place
        values[number, : len(one.values)] = one.values
    return Laws(rows, values)


def no_forces() -> StepForces:
    """Return the forces of a model without such effects."""
    return StepForces(table_of([]), table_of([]))


# -- Compiling -----------------------------------------------------------------

_COMPILED: dict[Law, Any] = {}  # kept forever: loops hold addresses
_LOCK = Lock()


def address_of_law(law: Law) -> int:
    """Return the address of a law's machine code, compiled on the first call.

    Raises:
        RlcoError: If numba cannot compile it.
    """
    with _LOCK:
        if law not in _COMPILED:
            _COMPILED[law] = _compiled(law)
        return int(_COMPILED[law].address)


def _compiled(law: Law) -> Any:
    function = getattr(law, "py_func", law)  # if numba has compiled it already
    if not isfunction(function):
        raise _LawError(law, "it is not a function")
    try:
        try:
            return cfunc(_SIGNATURE, cache=True, error_model="numpy")(function)
        except RuntimeError:  # numba cannot cache a function without a file
            return cfunc(_SIGNATURE, error_model="numpy")(function)
    except (NumbaError, TypeError) as error:
        lines = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()
        said = [line for line in lines if line and not line.startswith("Failed in")]
        raise _LawError(law, " ".join(said[:1])) from None


class _LawError(RlcoError):
    """A law that numba cannot compile."""

    def __init__(self, law: object, reason: str) -> None:
        super().__init__(
            f"the law {getattr(law, '__name__', law)!r} cannot be compiled ({reason}); "
            "write it as a function of position, velocity, torque, carried and values "
            "that returns a number, within what numba can compile."
        )


# -- Evaluating ----------------------------------------------------------------


@intrinsic
def _call(
    typing_context: Any,
    address: Any,
    position: Any,
    velocity: Any,
    torque: Any,
    carried: Any,
    values: Any,
) -> Any:
    """Call the law at an address with numbers, and with values at another address."""
    double = ir.DoubleType()
    function = ir.FunctionType(double, [*[double] * 4, double.as_pointer()])

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        law = builder.inttoptr(args[0], function.as_pointer())
        numbers = builder.inttoptr(args[5], double.as_pointer())
        return builder.call(law, [*args[1:5], numbers])

    return types.float64(types.intp, *[types.float64] * 4, types.intp), generate


@njit(nogil=True, cache=True)
def law_value(
    laws: Any, row: int, position: float, velocity: float, torque: float, carried: float
) -> float:
    """Return the value of the law in a row of a table."""
    values = laws.values.ctypes.data + 8 * laws.values.shape[1] * row
    force: float = _call(laws.rows[row, 0], position, velocity, torque, carried, values)
    return force


@njit(nogil=True, cache=True)
def law_along(
    laws: Any, row: int, position: Any, velocity: Any, torque: Any, carried: Any
) -> Any:
    """Return the values of the law in a row at T moments, (T,)."""
    found = np.empty(len(velocity))
    for t in range(len(velocity)):
        found[t] = law_value(laws, row, position[t], velocity[t], torque[t], carried[t])
    return found


@njit(nogil=True, cache=True)
def set_friction(
    laws: Any,
    qpos: Any,
    qvel: Any,
    actuation: Any,
    applied: Any,
    bias: Any,
    own: Any,
    friction: Any,
) -> None:
    """Write the friction of the joints with a friction law.

    Args:
        laws: Of friction.
        qpos: Current positions, (nq,).
        qvel: Current velocities, (nv,).
        actuation: ``qfrc_actuator`` of the previous step, (nv,).
        applied: ``qfrc_applied`` of the previous step, (nv,).
        bias: ``qfrc_bias`` of the previous step, (nv,).
        own: Coulomb friction of the model itself, (nv,).
        friction: Output: the model's ``dof_frictionloss``, (nv,).
    """
    rows = laws.rows
    for row in range(rows.shape[0]):
        friction[rows[row, 1]] = own[rows[row, 1]]
    for row in range(rows.shape[0]):
        d, place = rows[row, 1], rows[row, 2]
        carried = abs(actuation[d] + applied[d] + bias[d])
        friction[d] += law_value(laws, row, qpos[place], qvel[d], actuation[d], carried)


@njit(nogil=True, cache=True)
def set_torques(
    laws: Any, qpos: Any, qvel: Any, actuation: Any, bias: Any, applied: Any
) -> None:
    """Write the torques of the joints with a torque law.

    Args:
        laws: Of torques.
        qpos: Current positions, (nq,).
        qvel: Current velocities, (nv,).
        actuation: ``qfrc_actuator`` of this step, (nv,).
        bias: ``qfrc_bias`` of this step, (nv,).
        applied: Output: ``qfrc_applied``, (nv,).
    """
    rows = laws.rows
    for row in range(rows.shape[0]):
        applied[rows[row, 1]] = 0.0
    for row in range(rows.shape[0]):
        d, place = rows[row, 1], rows[row, 2]
        carried = abs(actuation[d] + bias[d])
        applied[d] += law_value(laws, row, qpos[place], qvel[d], actuation[d], carried)
