"""A tossed, dropped or pushed body: residuals of its measured pose against rollouts.

Each recording is rolled out open loop from its first pose and velocity. In free flight
only gravity acts; differences from the first touch on come from contact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco import rollout

from rlco.errors import DataError, UnknownNameError, counted
from rlco.gap.compare.first_velocity import FIRST_ROWS, first_velocity
from rlco.gap.compare.noise import measurement_noise
from rlco.gap.compare.problem import Candidate, Hypothesis, Layout, Problem, Run
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects import searched
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.contact import CONTACT_FRICTION
from rlco.physics.effects.inertia import OBJECT_MASS
from rlco.physics.effects.targets import free_bodies
from rlco.physics.mj.libmujoco import silenced_warnings

# Contact parameters with a tolerance everywhere: sliding friction and softness.
_TOLERANCES = ("friction", "solref")


class FreeBody(Problem):
    """A `Problem`: poses of a free body against rollouts from their initial states.

    Args:
        spec: The scene: the body with its free joint, and what it may touch.
        log: Its poses [m], quaternions (w, x, y, z); `body` is its name. Logged
            velocities, (T, 6), follow MuJoCo's convention: linear in the world frame
            [m/s], angular in the body frame [rad/s].
        horizon: Length of a rollout [s], None for whole recordings. A tumbling object
            soon loses its dependence on the initial state.
        noise: Standard deviation of a measured coordinate [m]; estimated from the
            recordings by default.
        threads: Rollouts that run in parallel.

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
        self.tolerance_names = _TOLERANCES if self._touching() else ()
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
        """Return each effect that a toss of one body can reveal."""
        chosen = [
            Candidate(effect.name, target)
            for effect in searched("flight")
            for target in effect.targets(self.model)
        ]
        if self.model.nv == 6 and self.model.nu == 0:
            # In MuJoCo, every contact force on a body among fixed ones scales with its
            # mass.
            chosen = [one for one in chosen if one.name != OBJECT_MASS.name]
        return chosen

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated positions, (hypotheses, N) [m]."""
        every = range(len(self._rows))
        chosen = [i for i in every if recordings is None or i in recordings]
        simulated = self._simulate(hypotheses, chosen)
        residuals = [
            np.concatenate(
                [
                    (self._poses[i][1 : self._rows[i], :3] - track).ravel()
                    for i, track in zip(chosen, tracks, strict=True)
                ]
            )
            for tracks in simulated
        ]
        found = np.stack(residuals)
        return np.where(np.isfinite(found), found, np.inf)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return the signals of one recording, see `Problem.traces`.

        ``contact`` is true from the measured body's first touch on, because an error
        made there persists in the flight that follows.
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
        """Return positions at the rows after the first, per recording, (rows, 3)."""
        models = [self._model(hypothesis) for hypothesis in hypotheses]
        # Times at which each track is read, in steps from its first row.
        reads = [self._read(i) for i in recordings]
        steps = max(_steps(read) for read in reads)
        data = [mujoco.MjData(self.model) for _ in range(self._threads)]
        with silenced_warnings():
            states, _ = self._pool.rollout(
                [model for model in models for _ in recordings],
                data,
                np.tile(self._starts[list(recordings)], (len(models), 1)),
                nstep=steps,
            )
        column = 1 + self._position
        positions = states[:, :, column : column + 3]
        # After a warning, MuJoCo resets its clock and repeats its last state.
        clock = float(self.model.opt.timestep) * (np.arange(steps) + 0.5)
        positions[np.logical_or.accumulate(states[:, :, 0] < clock, axis=1)] = np.nan
        first = np.tile(
            self._starts[list(recordings), None, column : column + 3],
            (len(models), 1, 1),
        )
        positions = np.concatenate([first, positions], axis=1)
        positions = positions.reshape(len(models), len(recordings), steps + 1, 3)
        return [
            [_between(track, read) for track, read in zip(tracks, reads, strict=True)]
            for tracks in positions
        ]

    def runs(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> list[Run]:
        """Return the rollouts of some recordings, see `Problem.runs`."""
        model, found = self._model(hypothesis), []
        for i in recordings:
            qpos, qvel = np.split(
                self._starts[i, 1 : 1 + model.nq + model.nv], [model.nq]
            )
            commands = np.zeros((_steps(self._read(i)), model.nu))
            time = float(self.log.recordings[i].time[0])
            found.append(Run(i, time, model, qpos, qvel, commands))
        return found

    def _read(self, recording: int) -> Array:
        """Return the times of a recording's rows after the first [steps], (rows,)."""
        times = self.log.recordings[recording].time[: self._rows[recording]]
        steps: Array = (times[1:] - times[0]) / float(self.model.opt.timestep)
        return steps

    def _model(self, hypothesis: Hypothesis) -> mujoco.MjModel:
        spec = self.spec.copy()
        parts = hypothesis.spread or (0.0,) * len(self.tolerance_names)
        for geom in spec.geoms:
            for name, part in zip(self.tolerance_names, parts, strict=True):
                values = np.array(getattr(geom, name))
                values[0] *= 1.0 + part
                setattr(geom, name, values)
        apply_to_spec(spec, hypothesis.effects)
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
        return bool(CONTACT_FRICTION.targets(self.model))

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
        message = f"{recording.name} has {counted(recording.rows, 'row')}"
        message += " without poses" if recording.pose is None else " of poses"
        raise DataError(message + ": give recordings of four poses or more.")
    return np.asarray(recording.pose, dtype=float)


def _rows(recording: Recording, horizon: float | None) -> int:
    if horizon is None:
        return recording.rows
    last = recording.time[0] + horizon + 1e-9
    return max(2, int(np.searchsorted(recording.time, last, side="right")))


def _steps(read: Array) -> int:
    return int(np.ceil(read[-1] - 1e-6))


def _between(track: Array, read: Array) -> Array:
    """Interpolate a track with one row per step at times in steps, (rows, 3)."""
    before = np.minimum(np.floor(read).astype(int), len(track) - 2)
    part = (read - before)[:, None]
    found: Array = (1.0 - part) * track[before] + part * track[before + 1]
    return found
