"""Checks of the native backend's arguments: threads, and differences between worlds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.mj.model_struct import HEADLIGHT, get_array, is_only_drawn

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Arrays that MuJoCo reads at every step or frame. Excluded are those that its compiler
# converts (trees, the boxes around geoms used to find contacts, flags such as "the
# frame of its body" or "has limits"), and limits of commands, which the controller has
# read.
_PATCHABLE = (
    f"{kind}_{name}"
    for kind, names in {
        "body": "pos quat mass inertia",
        "jnt": "stiffness solref solimp",
        "dof": "armature damping frictionloss solref solimp",
        "geom": "friction solmix solref solimp rgba",
        "site": "rgba",
        "cam": "pos quat fovy sensorsize intrinsic",
        "light": "active type pos dir ambient diffuse specular attenuation cutoff "
        "exponent",
        "mat": "rgba emission specular shininess reflectance texid texrepeat "
        "texuniform",
        "eq": "solref solimp",
        "tendon": "stiffness damping armature frictionloss rgba",
        "actuator": "gainprm biasprm gear",
    }.items()
    for name in names.split()
)
PATCHABLE = (*_PATCHABLE, HEADLIGHT)
# Arrays that must not be negative, and those that must not be zero unless they are.
_NOT_NEGATIVE = (
    "body_mass",
    "body_inertia",
    "jnt_stiffness",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "geom_friction",
    "tendon_stiffness",
    "tendon_damping",
    "tendon_armature",
    "tendon_frictionloss",
)
_POSITIVE = ("body_mass", "body_inertia")
# Indices and kinds, which are whole numbers from and below.
_LIGHT_KINDS = 3  # a spot, a direction, a point; not MuJoCo's fourth, an image


def check_threads(threads: int | None) -> None:
    """Check a number of threads.

    Raises:
        RlcoError: If it is neither None nor a whole number from 1.
    """
    if threads is None:
        return
    if not isinstance(threads, int | np.integer) or threads < 1:
        raise RlcoError(
            f"threads={threads!r} is not allowed; give 1 or more, or leave it out for "
            "one per core."
        )


def check_native(backend: str, *, threads: int | None, exact: bool) -> None:
    """Refuse options of the native backend where another is selected.

    Raises:
        RlcoError: If `threads` is less than 1, or either is given to ``robosuite``.
    """
    check_threads(threads)
    if backend == "native":
        return
    if threads is not None:
        raise RlcoError(
            f"threads={threads} is for backend='native'; backend={backend!r} steps one "
            "environment after the other, so leave it out."
        )
    if exact:
        raise RlcoError(
            f"exact=True is for backend='native'; backend={backend!r} computes with "
            "robosuite's own linear algebra anyway, so leave it out."
        )


def checked_worlds(which: Any, count: int) -> Integers:
    """Return indices of worlds, shape (R,).

    Raises:
        RlcoError: If they are not indices below `count`, or one occurs twice.
    """
    given = np.asarray(which)
    if given.size == 0:
        return np.zeros(0, dtype=np.int64)
    if given.ndim != 1 or given.dtype.kind not in "iu":
        raise RlcoError(
            f"which={which!r} is not allowed; give indices of worlds, shape (R,)."
        )
    if given.min() < 0 or given.max() >= count or len(set(given.tolist())) < len(given):
        raise RlcoError(
            f"which={given.tolist()} is not allowed; give indices from 0 to "
            f"{count - 1}, each once."
        )
    return given.astype(np.int64)


def checked_fields(
    model: mujoco.MjModel, fields: Mapping[str, Any], rows: int
) -> dict[str, NDArray[Any]]:
    """Return arrays of a model with a leading axis (rows,), one value per world.

    Args:
        model: The common model.
        fields: Arrays by MuJoCo's name, of the model's shape, or with that axis.
        rows: Number of worlds R.

    Raises:
        UnknownNameError: If the model has no array of that name.
        RlcoError: If a world cannot have that array of its own, or a shape or a value
            is wrong.
    """
    return {name: _checked(model, name, fields[name], rows) for name in fields}


def _checked(model: mujoco.MjModel, name: str, given: Any, rows: int) -> NDArray[Any]:
    if name not in PATCHABLE:
        if isinstance(getattr(type(model), name, None), property):
            raise RlcoError(
                f"{name} cannot differ between worlds, because MuJoCo's compiler or "
                "the controller has already converted it; change the model before it "
                f"is compiled, or give one of {', '.join(PATCHABLE)}."
            )
        raise UnknownNameError("array of mjModel", name, PATCHABLE)
    own = get_array(model, name)
    value = _numbers(name, given)
    if value.shape not in (own.shape, (rows, *own.shape)):
        raise RlcoError(
            f"{name} has shape {value.shape}; give {own.shape}, or "
            f"{(rows, *own.shape)} for one value per world."
        )
    if name in _NOT_NEGATIVE and (value < 0.0).any():
        raise RlcoError(f"{name} has negative values; give 0 or more.")
    if name in _POSITIVE and ((value == 0.0) & (own > 0.0)).any():
        raise RlcoError(
            f"{name} has zeros where the model has none; give more than 0 there."
        )
    if name.endswith("rgba") and ((value < 0.0) | (value > 1.0)).any():
        raise RlcoError(f"{name} has values outside [0, 1]; give shares of a colour.")
    _check_drawn(model, name, value)
    return np.broadcast_to(value, (rows, *own.shape))


def _check_drawn(model: mujoco.MjModel, name: str, value: Array) -> None:
    """Refuse values by which a renderer would read or divide wrongly.

    Raises:
        RlcoError: If one is out of range.
    """
    whole = {"mat_texid": (-1, model.ntex - 1), "light_type": (0, _LIGHT_KINDS - 1)}
    if name in whole:
        low, high = whole[name]
        if ((value < low) | (value > high) | (value != np.floor(value))).any():
            raise RlcoError(
                f"{name} has values that are none of the model's; give whole numbers "
                f"from {low} to {high}."
            )
    if name == "cam_fovy" and ((value <= 0.0) | (value >= 180.0)).any():
        raise RlcoError("cam_fovy has values outside (0, 180); give degrees inside.")
    if name == "cam_intrinsic" and (value[..., :2] <= 0.0).any():
        raise RlcoError("cam_intrinsic has focal lengths of 0; give more than 0.")
    if name == "cam_sensorsize" and (value < 0.0).any():
        raise RlcoError("cam_sensorsize has negative values; give 0 or more.")


def is_derived_from(name: str) -> bool:
    """Return whether MuJoCo derives other quantities from an array of the model.

    Example:
        >>> is_derived_from("body_mass"), is_derived_from("light_diffuse")
        (True, False)
    """
    if name.endswith(("_pos", "_quat", "_dir")):
        return True  # also of cameras and lights that follow a body
    return not is_only_drawn(name)


def checked_gains(
    name: str, given: Any, rows: int, axes: int, *, zero: bool
) -> Array | None:
    """Return a controller's gains, shape (R, D), or None where none are given.

    Args:
        name: ``stiffness`` or ``damping``.
        given: A number, one per world (R,), or one per axis, broadcast to (R, D).
        rows: Number of worlds R.
        axes: Dimensions D of the arm's commands.
        zero: Whether 0 is allowed.

    Raises:
        RlcoError: If the shape is another, or a value is out of range.
    """
    if given is None:
        return None
    value = _numbers(name, given)
    if value.shape == (rows,):
        value = value[:, None]
    wide = value.ndim == 2 and all(
        size in (1, whole)
        for size, whole in zip(value.shape, (rows, axes), strict=True)
    )
    if not (value.ndim == 0 or wide):
        raise RlcoError(
            f"{name} has shape {value.shape}; give a number, {(rows,)} for one per "
            f"world, or {(rows, axes)} or {(1, axes)} for one per axis."
        )
    if (value < 0.0).any() or (not zero and (value == 0.0).any()):
        least = "0 or more" if zero else "more than 0"
        raise RlcoError(f"{name}={given!r} is not allowed; give {least}.")
    return np.broadcast_to(value, (rows, axes))


def checked_delay(given: Any, rows: int) -> Integers | None:
    """Return command delays in control steps, shape (R,), or None where none is given.

    Raises:
        RlcoError: If they are not whole numbers from 0, or of another shape.
    """
    if given is None:
        return None
    value = _numbers("command_delay", given)
    if value.shape not in ((), (rows,)):
        raise RlcoError(
            f"command_delay has shape {value.shape}; give a number, or {(rows,)} for "
            "one per world."
        )
    if (value < 0.0).any() or (value != np.floor(value)).any():
        raise RlcoError(
            f"command_delay={given!r} is not allowed; give 0 or more whole control "
            "steps."
        )
    return np.broadcast_to(value.astype(np.int64), (rows,))


def _numbers(name: str, given: Any) -> Array:
    try:
        value = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise RlcoError(
            f"{name}={given!r} is not allowed; give an array of numbers."
        ) from None
    if not np.isfinite(value).all():
        raise RlcoError(f"{name} contains NaN or infinity; give finite numbers.")
    return value
