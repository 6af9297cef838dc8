"""What may be a little off in a model that torques are computed with.

Besides the numbers of `rlco.gap.spread`, where each link's mass has its centre: a real
arm's torques show it, and no model has it better than to a centimetre or so.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.spread import apply_spread, spread_names

# A part of one moves a centre by so much [m]: three per cent are a centimetre.
_CENTRE = 0.3
_SHOWN = ("mass", "inertia", "damping", "armature", "friction", "gain")


def torque_spread_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return ``kind:name`` for each number that changes a torque.

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><body name='arm'><joint name='j'/>"
        ...     "<geom size='0.1'/></body></worldbody></mujoco>")
        >>> torque_spread_names(model)
        ('mass:arm', 'inertia:arm', 'x:arm', 'y:arm', 'z:arm')
    """
    plain = tuple(
        name for name in spread_names(model) if name.partition(":")[0] in _SHOWN
    )
    bodies = [name.partition(":")[2] for name in plain if name.startswith("mass:")]
    return plain + tuple(f"{axis}:{body}" for body in bodies for axis in "xyz")


def apply_torque_spread(
    spec: mujoco.MjSpec, names: tuple[str, ...], parts: tuple[float, ...]
) -> None:
    """Move each number by its part, in place."""
    for full, part in zip(names, parts, strict=True):
        kind, _, name = full.partition(":")
        if kind not in "xyz":
            apply_spread(spec, (full,), (part,))
        elif part:
            body = spec.body(name)
            centre = np.array(body.ipos)
            centre["xyz".index(kind)] += _CENTRE * part
            body.ipos = centre
