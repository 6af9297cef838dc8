"""The C struct behind an `MjModel`: models that share all but a few arrays.

A compiled model with a robot's visual meshes takes 64 MB, so N worlds that differ only
in a mass need something smaller than N models. MuJoCo's functions access every array
through a pointer in the struct. A copy of the struct alone (some ten kilobytes) with a
few pointers replaced is a complete model for them.

The layout is the one described by the ``mujoco`` package itself
(``mujoco.introspect``), and is checked against the package's own arrays.
"""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect import ast_nodes, structs
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.mj.libmujoco import address_of

_SCALARS: dict[str, Any] = {
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "uint64_t": ctypes.c_uint64,
    "float": ctypes.c_float,
    "int": ctypes.c_int,
}


def _type_of(node: Any) -> Any:
    if isinstance(node, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(node, ast_nodes.ArrayType):
        return _type_of(node.inner_type) * int(np.prod(node.extents))
    if isinstance(node, ast_nodes.AnonymousStructDecl):
        return _struct("anonymous", node.fields)
    if node.name in structs.STRUCTS:
        return _struct(node.name, structs.STRUCTS[node.name].fields)
    return _SCALARS[node.name]


def _struct(name: str, fields: Any) -> Any:
    members = [(field.name, _type_of(field.type)) for field in fields]
    return type(name, (ctypes.Structure,), {"_fields_": members})


@functools.cache
def model_type() -> Any:
    """Return ``mjModel`` as a ctypes structure."""
    return _type_of(ast_nodes.ValueType("mjModel"))


@functools.cache
def array_fields() -> tuple[str, ...]:
    """Return the names of the numeric arrays that a copy may have of its own.

    Meshes, textures, height fields and names take most of the memory, and are shared.
    """
    shared = ("mesh_", "tex_", "hfield_", "skin_", "bvh_", "oct_", "name", "text_")
    return tuple(
        field.name
        for field in structs.STRUCTS["mjModel"].fields
        if isinstance(field.type, ast_nodes.PointerType)
        and not field.name.startswith((*shared, "paths"))
        and isinstance(getattr(mujoco.MjModel, field.name, None), property)
        and field.type.inner_type.name != "void"
    )


@dataclass(frozen=True)
class ModelValues:
    """The values in which a compiled model differs from another of its structure.

    Arrays that only drawing reads are none of them: a world's look and the places of
    its cameras are its own, whatever its physics is.

    Attributes:
        arrays: The arrays that differ, by MuJoCo's name.
        gravity: Of its options, (3,).
        statistics: Its ``stat``, as a ctypes structure.
    """

    arrays: dict[str, NDArray[Any]]
    gravity: NDArray[np.float64]
    statistics: Any

    @classmethod
    def of(cls, model: mujoco.MjModel, base: mujoco.MjModel) -> ModelValues:
        """Return the values of a model that `base` does not have.

        Raises:
            RlcoError: If the two differ in more than values.
        """
        values = cls.without_arrays(model)
        for name in array_fields():
            if is_only_drawn(name):
                continue
            mine, theirs = getattr(model, name), getattr(base, name)
            if mine.shape != theirs.shape:
                raise RlcoError(
                    f"two parameter sets of one sample give models of other sizes "
                    f"({name}: {mine.shape} and {theirs.shape}); leave the sample out."
                )
            if not np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f"):
                values.arrays[name] = mine.copy()
        return values

    @classmethod
    def without_arrays(cls, model: mujoco.MjModel) -> ModelValues:
        """Return a model's gravity and statistics alone."""
        whole = model_type().from_address(model._address)
        statistics = type(whole.stat).from_buffer_copy(whole.stat)
        return cls({}, model.opt.gravity.copy(), statistics)

    def write_to(self, model: mujoco.MjModel) -> None:
        """Write the values into a whole model."""
        for name, value in self.arrays.items():
            getattr(model, name)[:] = value
        model.opt.gravity[:] = self.gravity
        model_type().from_address(model._address).stat = self.statistics


#: The headlight's colours, as if they were an array of the model: ambient, diffuse and
#: specular light, (3, 3).
HEADLIGHT = "headlight"
_COLOURS = ("ambient", "diffuse", "specular")


def is_only_drawn(name: str) -> bool:
    """Return whether nothing but drawing reads an array of a model.

    Example:
        >>> is_only_drawn("cam_pos"), is_only_drawn("body_pos")
        (True, False)
    """
    of_scene = name.startswith(("mat_", "light_", "cam_")) or name == HEADLIGHT
    return of_scene or name.endswith("rgba")


def get_array(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    """Return a model's array of that name, or its `HEADLIGHT`."""
    if name == HEADLIGHT:
        return np.stack([getattr(model.vis.headlight, c) for c in _COLOURS])
    array: NDArray[Any] = getattr(model, name)
    return array


def set_array(model: mujoco.MjModel, name: str, value: NDArray[Any]) -> None:
    """Write a whole model's array of that name, or its `HEADLIGHT`."""
    if name == HEADLIGHT:
        for colour, row in zip(_COLOURS, value, strict=True):
            getattr(model.vis.headlight, colour)[:] = row
    else:
        getattr(model, name)[:] = value


class ModelCopy:
    """A model's struct, with its own arrays where `set_array` was called.

    Args:
        model: The model whose other arrays it shares; kept alive by it.

    Raises:
        RlcoError: If the installed MuJoCo has another struct layout.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        kind = model_type()
        self._struct = kind()
        ctypes.memmove(ctypes.byref(self._struct), model._address, ctypes.sizeof(kind))
        self.arrays: dict[str, NDArray[Any]] = {}
        if self._struct.signature != model.signature or any(
            getattr(model, name).size
            and getattr(self._struct, name) != address_of(getattr(model, name))
            for name in ("body_mass", "geom_friction", "qpos0", "actuator_gainprm")
        ):
            raise RlcoError(
                f"MuJoCo {mujoco.__version__} has another layout of mjModel than its "
                "mujoco.introspect says; install mujoco>=3.9,<3.10."
            )

    @property
    def address(self) -> int:
        """Address of the struct."""
        return ctypes.addressof(self._struct)

    def set_array(self, name: str, value: NDArray[Any]) -> None:
        """Give the copy its own array of that name, with this value."""
        if name == HEADLIGHT:
            # Part of the struct itself, not behind a pointer.
            for colour, row in zip(_COLOURS, value, strict=True):
                getattr(self._struct.vis.headlight, colour)[:] = row.tolist()
            return
        if name not in self.arrays:
            self.arrays[name] = getattr(self._model, name).copy()
            setattr(self._struct, name, address_of(self.arrays[name]))
        self.arrays[name][:] = value

    def become(self, values: ModelValues) -> None:
        """Take these values, and all others from the model that it is a copy of.

        What only drawing reads stays as it is.
        """
        for name in self.arrays.keys() - values.arrays.keys():
            if not is_only_drawn(name):
                self.set_array(name, getattr(self._model, name))
        for name, value in values.arrays.items():
            self.set_array(name, value)
        self._struct.opt.gravity[:] = values.gravity.tolist()
        self._struct.stat = values.statistics

    def take_statistics(self, model: mujoco.MjModel) -> None:
        """Adopt another model's statistics, which scale MuJoCo's solver."""
        self._struct.stat = model_type().from_address(model._address).stat

    def give_values(self, model: mujoco.MjModel) -> None:
        """Write the copy's statistics and headlight into a whole model."""
        struct = model_type().from_address(model._address)
        struct.stat = self._struct.stat
        struct.vis.headlight = self._struct.vis.headlight


def reserve_memory(model: mujoco.MjModel, size: int) -> None:
    """Set the memory that a state of this model reserves for its contacts [bytes].

    robosuite reserves 1.3 GB, and needs less than one megabyte of it.
    """
    ModelCopy(model)  # checks the layout
    model_type().from_address(model._address).narena = size
