"""A body that was tossed, dropped or pushed: its measured pose against rollouts.

Each recording is rolled out open loop from its first pose and velocity. In free flight
nothing but gravity acts; what differs from the first touch on is a matter of contact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco import rollout

from rlco.errors import DataError, UnknownNameError
from rlco.gap.first_velocity import FIRST_ROWS, first_velocity
from rlco.gap.log import Array, Log, Recording
from rlco.gap.noise import measurement_noise
from rlco.gap.problem import Candidate, Hypothesis, Layout, Problem
from rlco.physics.effects import EFFECTS
from rlco.physics.effects.targets import free_bodies

_SHOWN = ("contact_friction", "contact_stiffness", "object_mass", "gravity_tilt")
# What may be a little off everywhere: how contacts slide and how soft they are.
_SPREAD = {"friction": "contact_friction", "solref": "contact_stiffness"}


class FreeBody(Problem):
    """A `Problem`: poses of a free body against rollouts from where each began.

    Args:
        spec: The scene: the body with its free joint, and what it may touch.
        log: Its poses [m], quaternions (w, x, y, z); `body` is its name. Where
            velocities were logged, (T, 6), they are MuJoCo's: linear in the world's
            frame [m/s], angular in the body's [rad/s].
        horizon: Seconds of a rollout, None for whole recordings: an object that
            tumbles forgets where it came from.
        noise: Standard deviation of a measured coordinate [m]; by default from the
            recordings.
        threads: Rollouts at a time.

    Raises:
        UnknownNameError: If no free joint moves a body of that name.
        DataError: If a recording has no poses or fewer than four rows.

    Example:
        >>> spec = mujoco.MjSpec.from_string(
        ...     "<mujoco><worldbody><body name='ball'><freejoint/>"
        ...     "<geom size='0.1'/></body></worldbody></mujoco>")
        >>> time = np.arange(20) * 0.02
        >>> pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (20, 1))
        >>> pose[:, 2] = time - 9.81 * time**2 / 2
        >>> up = np.tile([0.0, 0, 1, 0, 0, 0], (20, 1))
        >>> toss = Recording("toss", time, pose=pose, velocity=up)
        >>> problem = FreeBody(spec, Log((toss,), body="ball"))
        >>> bool(np.abs(problem.residuals([Hypothesis()])).max() < 5e-3)
        True
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        log: Log,
        *,
        horizon: float | None = None,
        noise: Array | None = None,
        threads: int = 2,
    ) -> None:
        self.spec, self.log = spec, log
        self.model: mujoco.MjModel = spec.copy().compile()
        known = free_bodies(self.model)
        if log.body not in known:
            raise UnknownNameError("free body", str(log.body), known)
        joint = self.model.body(log.body).jntadr[0]
        self._position = int(self.model.jnt_qposadr[joint])
        self._velocity = int(self.model.jnt_dofadr[joint])
        self.spread_names = tuple(_SPREAD) if self._touching() else ()
        self._rows = [_rows(recording, horizon) for recording in log.recordings]
        self._poses = [_poses(recording) for recording in log.recordings]
        gravity = np.array(self.model.opt.gravity)
        self._starts = np.stack(
            [self._start(recording, gravity) for recording in log.recordings]
        )
        self._threads = threads
        self._pool = rollout.Rollout(nthread=threads)
        self.layout = self._layout()
        self.noise = self._noise() if noise is None else np.asarray(noise)

    def candidates(self) -> list[Candidate]:
        """Return each effect that a toss of one body can show."""
        shown = [
            Candidate(name, target)
            for name in _SHOWN
            for target in EFFECTS[name].targets(self.model)
        ]
        if self.model.nv == 6 and self.model.nu == 0:
            # All forces on a body among fixed ones grow with its mass, as in MuJoCo.
            shown = [one for one in shown if one.name != "object_mass"]
        return shown

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated places, (hypotheses, N) [m]."""
        every = range(len(self._rows))
        chosen = [i for i in every if recordings is None or i in recordings]
        simulated = self._simulate(hypotheses, chosen)
        left = [
            np.concatenate(
                [
                    (self._poses[i][1 : self._rows[i], :3] - track).ravel()
                    for i, track in zip(chosen, tracks, strict=True)
                ]
            )
            for tracks in simulated
        ]
        found = np.stack(left)
        return np.where(np.isfinite(found), found, np.inf)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, see `Problem.traces`.

        ``contact`` is true from the measured body's first touch on: what a rollout
        gets wrong there stays wrong in the flight that follows.
        """
        rows = self._rows[recording]
        pose = self._poses[recording][:rows]
        simulated = pose[:, :3].copy()
        simulated[1:] = self._simulate([hypothesis], [recording])[0][0]
        time = self.log.recordings[recording].time[:rows]
        velocity = np.gradient(pose[:, :3], time, axis=0)
        return {
            "time": time,
            "measured": pose[:, :3],
            "simulated": simulated,
            "velocity": velocity,
            "acceleration": np.gradient(velocity, time, axis=0),
            "contact": np.maximum.accumulate(self._touches(pose)),
        }

    def _simulate(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int]
    ) -> list[list[Array]]:
        """Return places at the rows after the first, of each recording, (rows, 3)."""
        models = [self._model(hypothesis) for hypothesis in hypotheses]
        step = float(self.model.opt.timestep)
        # Times at which each track is read, in steps from its first row.
        reads = []
        for i in recordings:
            times = self.log.recordings[i].time[: self._rows[i]]
            reads.append((times[1:] - times[0]) / step)
        steps = max(int(np.ceil(read[-1] - 1e-6)) for read in reads)
        data = [mujoco.MjData(self.model) for _ in range(self._threads)]
        states, _ = self._pool.rollout(
            [model for model in models for _ in recordings],
            data,
            np.tile(self._starts[list(recordings)], (len(models), 1)),
            nstep=steps,
        )
        column = 1 + self._position
        places = states[:, :, column : column + 3]
        first = np.tile(
            self._starts[list(recordings), None, column : column + 3],
            (len(models), 1, 1),
        )
        places = np.concatenate([first, places], axis=1)
        places = places.reshape(len(models), len(recordings), steps + 1, 3)
        return [
            [_between(track, read) for track, read in zip(tracks, reads, strict=True)]
            for tracks in places
        ]

    def _model(self, hypothesis: Hypothesis) -> mujoco.MjModel:
        spec = self.spec.copy()
        parts = hypothesis.spread or (0.0,) * len(self.spread_names)
        for geom in spec.geoms:
            for name, part in zip(self.spread_names, parts, strict=True):
                values = np.array(getattr(geom, name))
                values[0] *= 1.0 + part
                setattr(geom, name, values)
        for applied in hypothesis.effects:
            change = EFFECTS[applied.name].on_spec
            if change is not None:
                change(spec, applied.target, applied.values)
        return spec.compile()

    def _start(self, recording: Recording, gravity: Array) -> Array:
        """Return MuJoCo's full physics state at the first row, (1 + nq + nv + na,)."""
        model, pose = self.model, _poses(recording)
        state = np.zeros(
            mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        )
        state[1 : 1 + model.nq] = model.qpos0
        at = 1 + self._position
        state[at : at + 7] = pose[0]
        at = 1 + model.nq + self._velocity
        if recording.velocity is not None:
            state[at : at + 6] = recording.velocity[0]
        else:
            state[at : at + 6] = first_velocity(recording.time, pose, gravity)
        return state

    def _touches(self, poses: Array) -> Array:
        """Return whether the measured body touches anything in each row, (rows,)."""
        data = mujoco.MjData(self.model)
        body = self.model.body(self.log.body).id
        found = np.zeros(len(poses), dtype=bool)
        for row, pose in enumerate(poses):
            data.qpos[self._position : self._position + 7] = pose
            mujoco.mj_fwdPosition(self.model, data)
            bodies = self.model.geom_bodyid[data.contact.geom]
            found[row] = bool((self.model.body_rootid[bodies] == body).any())
        return found

    def _touching(self) -> bool:
        return bool(EFFECTS["contact_friction"].targets(self.model))

    def _noise(self) -> Array:
        parts = [
            (recording.time, poses[:, :3])
            for recording, poses in zip(self.log.recordings, self._poses, strict=True)
        ]
        return measurement_noise(parts).deviation

    def _layout(self) -> Layout:
        rows = np.array(self._rows) - 1
        times = [
            recording.time[1:count]
            for recording, count in zip(self.log.recordings, self._rows, strict=True)
        ]
        return Layout(
            np.repeat(np.arange(len(rows)), 3 * rows),
            np.repeat(np.concatenate(times), 3),
            np.tile(np.arange(3), int(rows.sum())),
            ("x", "y", "z"),
            ("m", "m", "m"),
        )


def rms_by_phase(problem: FreeBody, hypothesis: Hypothesis) -> tuple[float, float]:
    """Return the distance to the measured body before and after its first touch.

    Returns:
        Root mean squares over all recordings, in free flight and from the first touch
        on [m]; NaN for a phase that no recording has.
    """
    away, touched = [], []
    for index in range(len(problem.log.recordings)):
        trace = problem.traces(hypothesis, index)
        away.append(((trace["measured"] - trace["simulated"]) ** 2).sum(axis=1))
        touched.append(trace["contact"] > 0.5)
    squares, contact = np.concatenate(away), np.concatenate(touched)
    free, after = (
        float(np.sqrt(squares[rows].mean())) if rows.any() else np.nan
        for rows in (np.logical_not(contact), contact)
    )
    return free, after


def _poses(recording: Recording) -> Array:
    if recording.pose is None or recording.rows < FIRST_ROWS:
        message = f"{recording.name} has {recording.rows} rows"
        message += " without poses" if recording.pose is None else " of poses"
        raise DataError(message + ": give recordings of four poses or more.")
    return np.asarray(recording.pose, dtype=float)


def _rows(recording: Recording, horizon: float | None) -> int:
    if horizon is None:
        return recording.rows
    last = recording.time[0] + horizon + 1e-9
    return max(2, int(np.searchsorted(recording.time, last, side="right")))


def _between(track: Array, read: Array) -> Array:
    """Interpolate a track of one row a step at times in steps, (rows, 3)."""
    before = np.minimum(np.floor(read).astype(int), len(track) - 2)
    part = (read - before)[:, None]
    found: Array = (1.0 - part) * track[before] + part * track[before + 1]
    return found
