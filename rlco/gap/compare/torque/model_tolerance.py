"""Model tolerance for torques computed by inverse dynamics.

Besides the parameters of `rlco.gap.compare.model_tolerance`, each link's centre of mass
has a tolerance: a real arm's torques depend on it, and models know it to about one
centimetre at best.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.compare.model_tolerance import apply_tolerance, tolerance_names

# Shift of a centre of mass for a relative change of one [m]: 3 % are one centimetre.
_CENTRE = 0.3
_OBSERVABLE = ("mass", "inertia", "damping", "armature", "friction", "gain")


def torque_tolerance_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return ``kind:name`` for each parameter that changes a torque.

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><body name='arm'><joint name='j'/>"
        ...     "<geom size='0.1'/></body></worldbody></mujoco>")
        >>> torque_tolerance_names(model)
        ('mass:arm', 'inertia:arm', 'x:arm', 'y:arm', 'z:arm')
    """
    plain = tuple(
        name for name in tolerance_names(model) if name.partition(":")[0] in _OBSERVABLE
    )
    bodies = [name.partition(":")[2] for name in plain if name.startswith("mass:")]
    return plain + tuple(f"{axis}:{body}" for body in bodies for axis in "xyz")


def apply_torque_tolerance(
    spec: mujoco.MjSpec, names: tuple[str, ...], parts: tuple[float, ...]
) -> None:
    """Change each parameter by its part, in place."""
    for full, part in zip(names, parts, strict=True):
        kind, _, name = full.partition(":")
        if kind not in "xyz":
            apply_tolerance(spec, (full,), (part,))
        elif part:
            body = spec.body(name)
            centre = np.array(body.ipos)
            centre["xyz".index(kind)] += _CENTRE * part
            body.ipos = centre
