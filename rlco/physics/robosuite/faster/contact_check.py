"""Fast check whether two groups of geoms touch, for many states of one model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlco.physics.robosuite.robosuite_api import MujocoModel

Geoms = str | Sequence[str] | Any


class ContactCheck:
    """robosuite's ``env.check_contact`` without its loop over contacts and names.

    With shaped rewards robosuite checks this several times per control step, and looks
    up two names per contact each time.

    Args:
        env: A robosuite environment.
    """

    def __init__(self, env: Any) -> None:
        self._sim = env.sim
        self._members: dict[tuple[str, ...], NDArray[np.bool_]] = {}

    def __call__(self, geoms_1: Geoms, geoms_2: Geoms = None) -> bool:
        """Return whether any geom of the first group touches any of the second.

        Args:
            geoms_1: A geom's name, names, or a robosuite model for its own geoms.
            geoms_2: The same; None: any geom.
        """
        pairs = self._sim.data._data.contact.geom
        first = self._group(geoms_1)[pairs]
        if geoms_2 is None:
            return bool(first.any())
        second = self._group(geoms_2)[pairs]
        return bool((first & second[:, ::-1]).any())

    def _group(self, geoms: Geoms) -> NDArray[np.bool_]:
        """Return the mask of a group's geoms, shape (ngeom,)."""
        if isinstance(geoms, MujocoModel):
            geoms = geoms.contact_geoms
        names = (geoms,) if isinstance(geoms, str) else tuple(geoms)
        if names not in self._members:
            model = self._sim.model._model
            members = np.zeros(model.ngeom, dtype=np.bool_)
            known = {model.geom(index).name: index for index in range(model.ngeom)}
            members[[known[name] for name in names if name in known]] = True
            self._members[names] = members
        return self._members[names]
