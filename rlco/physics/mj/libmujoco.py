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


@intrinsic
def _as_float_pointer(typing_context: Any, address: Any) -> Any:
    """Reinterpret an integer address as a pointer to doubles."""
    pointer = types.CPointer(types.float64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], context.get_value_type(pointer))

    return pointer(types.intp), generate


@njit(inline="always")
def doubles(address: int, size: int) -> NDArray[np.float64]:
    """Return a view of `size` doubles at an address, shape (size,)."""
    view: NDArray[np.float64] = carray(_as_float_pointer(address), (size,))
    return view


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
