"""Arrays as keys of what is computed from them once, for all scenes that have them."""

from __future__ import annotations

import hashlib
from typing import Any

from numpy.typing import NDArray


class SameArrays:
    """Arrays of one's own, equal to others of the same shapes and bytes.

    The meshes and textures of a robot are the same in all its scenes.

    Example:
        >>> import numpy as np
        >>> SameArrays(np.zeros(3)) == SameArrays(np.zeros(3))
        True
        >>> SameArrays(np.zeros(3)) == SameArrays(np.zeros((3, 1)))
        False
        >>> SameArrays(np.zeros(3)) == SameArrays(np.ones(3))
        False
    """

    def __init__(self, *arrays: NDArray[Any]) -> None:
        # MuJoCo's arrays are views of a model that may be freed.
        self.arrays = tuple(array.copy() for array in arrays)
        digest = hashlib.blake2b(digest_size=16)
        for array in self.arrays:
            digest.update(repr(array.shape).encode())
            digest.update(array.tobytes())
        self._key = digest.digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SameArrays) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)
