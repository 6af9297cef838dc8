"""What `stand_in` differs in from the simulator: the gaps of the planar map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rlco.errors import UnknownNameError

Array = NDArray[np.float64]

NUMBERS = 12  # that the camera reports: three discs and three marks, x and y each


@dataclass(frozen=True)
class Gap:
    """How a domain moves and observes; the defaults are the simulator.

    Attributes:
        gain: Of the tool's motion.
        delay: Control steps that a command waits.
        slip: Share of the tool's motion that a disc in contact does not follow.
        yaw: Of the camera about the vertical [degrees].
        shift: Of the camera's origin [m].
        noise: Standard deviation of what the camera reports [m].
        rotated: Whether the twelve reported values are multiplied by a fixed
            rotation: then no value means what it means in the simulator.
    """

    gain: float = 1.0
    delay: int = 0
    slip: float = 0.0
    yaw: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    noise: float = 0.001
    rotated: bool = False

    def report(self, points: Array, noise: Array) -> Array:
        """Return points as the camera reports them [m].

        Args:
            points: Where they are [m], shape (N, 6, 2).
            noise: Standard normal, the same shape.

        Returns:
            Shape (N, 12).

        Example:
            >>> points = np.zeros((1, 6, 2))
            >>> points[0, 0] = 0.1, 0.0
            >>> Gap(yaw=90.0).report(points, np.zeros_like(points))[0, :2].round(3)
            array([0. , 0.1])
        """
        cosine, sine = _cosine(self.yaw), _sine(self.yaw)
        turned = points @ np.array([[cosine, sine], [-sine, cosine]])
        reported = turned + np.array(self.shift) + self.noise * noise
        flat = reported.reshape(len(points), NUMBERS)
        return flat @ ROTATION if self.rotated else flat


def _cosine(degrees: float) -> float:
    return math.cos(math.radians(degrees))


def _sine(degrees: float) -> float:
    return math.sin(math.radians(degrees))


def _rotation() -> Array:
    """Return a rotation of twelve dimensions, always the same.

    The orthogonal factor of a normal matrix, with the signs that make it unique: LAPACK
    leaves them open.
    """
    normal = np.random.default_rng(7).standard_normal((NUMBERS, NUMBERS))
    orthogonal, upper = np.linalg.qr(normal)
    orthogonal = orthogonal * np.sign(np.diag(upper))
    if np.linalg.det(orthogonal) < 0:
        orthogonal[:, 0] *= -1.0
    return np.ascontiguousarray(orthogonal)


ROTATION = _rotation()

SIM = Gap()

#: What `stand_in` has in every column: a slower tool, slip, and a camera that stands a
#: little elsewhere and is less precise. The columns differ in the rest.
_STAND_IN = Gap(gain=0.8, slip=0.15, shift=(0.025, -0.015), noise=0.003)

GAPS = {
    **{f"yaw{d}": replace(_STAND_IN, yaw=float(d)) for d in (0, 8, 45, 90, 135, 180)},
    "rotation": replace(_STAND_IN, rotated=True),
    "delay_gain": replace(_STAND_IN, yaw=8.0, delay=1, gain=0.6),
}


def named_gap(name: str) -> Gap:
    """Return a gap by its name.

    Raises:
        UnknownNameError: There is no such gap.
    """
    if name not in GAPS:
        raise UnknownNameError("gap", name, list(GAPS))
    return GAPS[name]
