"""The options of a model's physics, such as its time step: what can be simulated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from rlco.errors import RlcoError


@dataclass(frozen=True)
class _Range:
    """What an option may be, each number of it."""

    low: float
    high: float
    unit: str = ""


_FINITE = _Range(-1e10, 1e10)
_COUNT = _Range(0, 10_000)
#: By their names in MJCF's ``<option>``. No controller of a robot is faster than 100
#: kHz, and none follows a command in steps of more than 0.1 s; gravity may be in mm.
_RANGES = {
    "timestep": _Range(1e-5, 0.1, " s"),
    "gravity": _Range(-1e5, 1e5, " m/s^2"),
    "wind": _Range(-1e5, 1e5, " m/s"),
    "density": _Range(0, 1e6, " kg/m^3"),
    "viscosity": _Range(0, 1e6, " Pa s"),
    "impratio": _Range(1e-6, 1e6),
    "tolerance": _Range(0, 1e10),
    "ls_tolerance": _Range(0, 1e10),
    "noslip_tolerance": _Range(0, 1e10),
    "ccd_tolerance": _Range(0, 1e10),
    "iterations": _COUNT,
    "ls_iterations": _COUNT,
    "noslip_iterations": _COUNT,
    "ccd_iterations": _COUNT,
    "sdf_iterations": _COUNT,
    "sdf_initpoints": _COUNT,
    "magnetic": _FINITE,
    "o_margin": _FINITE,
    "o_solref": _FINITE,
    "o_solimp": _FINITE,
    "o_friction": _FINITE,
}


def check_options(path: Path, option: mujoco.MjOption) -> None:
    """Check that a model can be simulated with its options.

    MuJoCo takes a time step of 0, or NaN for gravity, and simulates nothing with it.

    Args:
        path: The model's file, for messages.
        option: Of its spec or of the compiled model.

    Raises:
        RlcoError: One of them is beyond what can be simulated.

    Example:
        >>> option = mujoco.MjSpec().option
        >>> option.timestep = 0.0
        >>> check_options(Path("arm.xml"), option)
        Traceback (most recent call last):
        ...
        rlco.errors.RlcoError: the option timestep of model 'arm.xml' is 0, and 1e-05 \
to 0.1 s can be simulated; correct it in the model.
    """
    for name, allowed in _RANGES.items():
        for value in np.ravel(getattr(option, name)).tolist():
            if allowed.low <= value <= allowed.high:
                continue
            raise RlcoError(
                f"the option {name} of model {str(path)!r} is {value:g}, and "
                f"{allowed.low:g} to {allowed.high:g}{allowed.unit} can be simulated; "
                "correct it in the model."
            )
