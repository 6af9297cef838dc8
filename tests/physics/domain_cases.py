"""Domains that differ in one thing."""

from __future__ import annotations

from typing import Any

from rlco.physics.effects import AppliedEffect
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.sensors import Sensors


def scaled(**factors: float) -> Domain:
    """Return a domain with effects of a task's scene: ``scaled(scene_mass=1.4)``."""
    rows = [AppliedEffect(k, None, {"factor": v}) for k, v in factors.items()]
    return Domain("scaled", tuple(rows))


def reporting(**errors: Any) -> Domain:
    """Return a domain with these errors of sensors alone, and no noise beside them."""
    return Domain("reporting", sensors=Sensors(**{"object_noise": 0.0, **errors}))
