"""MuJoCo's C functions and struct fields, callable from numba without the GIL.

The functions are external symbols of the library that the ``mujoco`` package has
loaded, so compiled code can be cached on disk. Models and data are passed as the
addresses that the Python objects give (``MjModel._address``).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
import numpy as np
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from rlco.physics.mj.compiling import announce
from rlco.physics.mj.stale_kernels import forget_stale_kernels

forget_stale_kernels()
announce()
_LIBRARY = next(Path(mujoco.__file__).parent.glob("libmujoco*"))
llvmlite.binding.load_library_permanently(str(_LIBRARY))

_MODEL_DATA = types.void(types.intp, types.intp)
mj_step1 = types.ExternalFunction("mj_step1", _MODEL_DATA)
mj_step2 = types.ExternalFunction("mj_step2", _MODEL_DATA)
mj_step = types.ExternalFunction("mj_step", _MODEL_DATA)
mj_fwdActuation = types.ExternalFunction("mj_fwdActuation", _MODEL_DATA)
mj_inverse = types.ExternalFunction("mj_inverse", _MODEL_DATA)
mj_forward = types.ExternalFunction("mj_forward", _MODEL_DATA)
mj_kinematics = types.ExternalFunction("mj_kinematics", _MODEL_DATA)
mj_comPos = types.ExternalFunction("mj_comPos", _MODEL_DATA)
mj_makeM = types.ExternalFunction("mj_makeM", _MODEL_DATA)
mj_comVel = types.ExternalFunction("mj_comVel", _MODEL_DATA)
mj_rne = types.ExternalFunction(
    "mj_rne", types.void(types.intp, types.intp, types.intc, types.intp)
)
mj_resetData = types.ExternalFunction("mj_resetData", _MODEL_DATA)
mj_jacSite = types.ExternalFunction(
    "mj_jacSite",
    types.void(*[types.intp] * 4, types.intc),
)


def _pointer_to(kind: Any) -> Any:
    """Return a compiled function that reinterprets an integer address as a pointer."""
    pointer = types.CPointer(kind)

    @intrinsic
    def reinterpret(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(pointer))

        return pointer(types.intp), generate

    return reinterpret


_as_doubles = _pointer_to(types.float64)
_as_floats = _pointer_to(types.float32)
_as_integers = _pointer_to(types.int32)
_as_bytes = _pointer_to(types.uint8)
_as_addresses = _pointer_to(types.intp)


@njit(inline="always")
def doubles(address: int, size: int) -> NDArray[np.float64]:
    """Return a view of `size` doubles at an address, shape (size,)."""
    view: NDArray[np.float64] = carray(_as_doubles(address), (size,))
    return view


@njit(inline="always")
def floats(address: int, size: int) -> NDArray[np.float32]:
    """Return a view of `size` single-precision numbers at an address, (size,)."""
    view: NDArray[np.float32] = carray(_as_floats(address), (size,))
    return view


@njit(inline="always")
def integers(address: int, size: int) -> NDArray[np.int32]:
    """Return a view of `size` 32-bit integers at an address, shape (size,)."""
    view: NDArray[np.int32] = carray(_as_integers(address), (size,))
    return view


@njit(inline="always")
def flag_at(address: int) -> bool:
    """Return whether the byte at an address is not zero."""
    return bool(carray(_as_bytes(address), (1,))[0])


@njit(inline="always")
def pointer_at(address: int) -> int:
    """Return the address that is stored at an address."""
    return int(carray(_as_addresses(address), (1,))[0])


def address_of(array: NDArray[Any]) -> int:
    """Return the address of an array's first element."""
    return int(array.__array_interface__["data"][0])


@cfunc("void(voidptr)", cache=True)
def _ignore(message: Any) -> None:
    """Do nothing: MuJoCo also counts its warnings in the ``mjData``."""


@contextmanager
def silenced_warnings() -> Iterator[None]:
    """Keep MuJoCo from printing warnings and from writing ``MUJOCO_LOG.TXT``.

    For searches whose trial values may diverge; ``mjData`` counts warnings as well.
    """
    library = ctypes.CDLL(str(_LIBRARY))
    handler = ctypes.c_void_p.in_dll(library, "mju_user_warning")
    before = handler.value
    handler.value = _ignore.address
    try:
        yield
    finally:
        handler.value = before
