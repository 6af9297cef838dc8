"""Rotations of arrays with leading batch axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector of rotation matrices, (..., 3, 3) -> (..., 3), [rad].

    Example:
        >>> import numpy as np
        >>> quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        >>> rotation_vector(quarter).round(4).tolist()
        [0.0, 0.0, 1.5708]
    """
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat).reshape(*rotation.shape[:-2], 3)


def yaw_matrix(angle: float) -> NDArray[np.float64]:
    """Return the 2x2 matrix that turns the plane by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
