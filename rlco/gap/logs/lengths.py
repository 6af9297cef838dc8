"""Lengths of a free body's pose that are not metres."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from rlco.gap.logs.log import Log, Recording

#: The fact that gives a log's unit of length: gravity in that unit per second squared.
GRAVITY = "g"
_SPEEDS = ("vx", "vy", "vz")
# Gravity differs by less than this from place to place.
_SAME = 0.02


def to_metres(log: Log, model: mujoco.MjModel) -> Log:
    """Return the log with poses in metres, where its facts give their gravity.

    Tracking is often in units of the tracked body's size. What falls with ``g = 187``
    units per second squared, where the model's gravity is 9.81 m/s^2, is measured in
    units of 0.0524 m.

    Example:
        >>> pose = np.tile([1.0, 0, 0, 1, 0, 0, 0], (2, 1))
        >>> log = Log((Recording("a", np.arange(2.0), pose=pose, facts={"g": 98.1}),))
        >>> model = mujoco.MjModel.from_xml_string("<mujoco/>")
        >>> to_metres(log, model).recordings[0].pose[0, :3].round(3)
        array([0.1, 0. , 0. ])
    """
    gravity = float(np.linalg.norm(model.opt.gravity)) or 9.81
    units = {gravity / r.facts[GRAVITY] for r in log.recordings if r.facts.get(GRAVITY)}
    if len(units) != 1 or abs((unit := units.pop()) - 1.0) < _SAME:
        return log
    note = (
        f"Lengths are in units of {unit:.4g} m, since g is {gravity / unit:.4g} of "
        "them per second squared, and were converted."
    )
    recordings = tuple(_scaled(recording, unit) for recording in log.recordings)
    return replace(log, recordings=recordings, notes=(*log.notes, note))


def _scaled(recording: Recording, unit: float) -> Recording:
    if recording.pose is None:
        return recording
    pose = recording.pose * np.r_[np.full(3, unit), np.ones(4)]
    extra = {
        key: values * unit if key in _SPEEDS else values
        for key, values in recording.extra.items()
    }
    return replace(recording, pose=pose, extra=extra)
