"""Small real problems: a two-joint arm with a hidden effect, and a tossed ball."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.search.state import State
from rlco.physics.effects import EFFECTS, AppliedEffect

ARM = """
<mujoco model="two">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 0 1" damping="0.3" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.8"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.3" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="40" kv="2" forcerange="-9 9"/>
    <position name="elbow" joint="elbow" kp="40" kv="2" forcerange="-9 9"/>
  </actuator>
</mujoco>
"""
BALL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="ball" pos="0 0 1">
      <freejoint/>
      <geom type="sphere" size="0.05" mass="0.2" solref="-3000 -5"/>
    </body>
  </worldbody>
</mujoco>
"""
NOISE = 4e-4
PERIOD, SECONDS = 0.02, 8.0


class Rolled(Problem):
    """A `Problem` that simulates each recording whole, in a loop of `mj_step`."""

    def __init__(self, xml: str, log: Log, channels: Sequence[str], unit: str) -> None:
        self.spec = mujoco.MjSpec.from_string(xml)
        self.model = self.spec.compile()
        self.log, self.tolerance_names = log, ()
        self.noise = np.full(len(channels), NOISE)
        self.every = round(PERIOD / self.model.opt.timestep)
        rows, count = [r.rows for r in log.recordings], len(channels)
        self.layout = Layout(
            np.repeat(np.arange(len(rows)), np.array(rows) * count),
            np.repeat(np.concatenate([r.time for r in log.recordings]), count),
            np.tile(np.arange(count), sum(rows)),
            tuple(channels),
            (unit,) * count,
        )

    def candidates(self) -> list[Candidate]:
        return [Candidate("coulomb_friction", name) for name in self.layout.channels]

    def model_under(self, hypothesis: Hypothesis) -> mujoco.MjModel:
        spec = self.spec.copy()
        for effect in hypothesis.effects:
            change = EFFECTS[effect.name].on_spec
            assert change is not None, "only effects of the model are for this problem"
            change(spec, effect.target, effect.values)
        return spec.compile()

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        chosen = range(len(self.log.recordings)) if recordings is None else recordings
        rows = []
        for hypothesis in hypotheses:
            traces = [self.traces(hypothesis, index) for index in sorted(chosen)]
            rows.append(
                np.concatenate(
                    [(t["measured"] - t["simulated"]).ravel() for t in traces]
                )
            )
        return np.stack(rows)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        raise NotImplementedError


class Arm(Rolled):
    """Joint positions of the two-joint arm."""

    def __init__(self, log: Log) -> None:
        super().__init__(ARM, log, log.joints, "rad")

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        log, model = self.log.recordings[recording], self.model_under(hypothesis)
        assert log.position is not None
        assert log.command is not None
        track, torque = swing(model, log.command, log.position[0], self.every)
        return {
            "time": log.time,
            "measured": log.position,
            "simulated": track,
            "command": log.command,
            "torque": torque,
        }


class Interruptible(Arm):
    """An arm of which a Ctrl-C ends one of its simulations, counted from 1; 0: none.

    What is there to be named: friction and damping of each joint.
    """

    def __init__(self, log: Log, interrupt_at: int = 0) -> None:
        super().__init__(log)
        self.calls, self.interrupt_at = 0, interrupt_at
        self.known: dict[tuple[object, ...], Mapping[str, Array]] = {}

    def again(self, interrupt_at: int) -> Interruptible:
        """Return the same, interrupted at a call; what was simulated stays known."""
        fresh = Interruptible(self.log, interrupt_at)
        fresh.known = self.known
        return fresh

    def candidates(self) -> list[Candidate]:
        names = ("coulomb_friction", "viscous_damping")
        return [Candidate(n, joint) for n in names for joint in self.layout.channels]

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        self.calls += 1
        if self.calls == self.interrupt_at:
            raise KeyboardInterrupt
        return super().residuals(hypotheses, recordings)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        effects = [(e.name, e.target, *e.values) for e in hypothesis.effects]
        key = (recording, *effects)
        if key not in self.known:
            self.known[key] = super().traces(hypothesis, recording)
        return self.known[key]


class Ball(Rolled):
    """The place of the ball."""

    def __init__(self, log: Log) -> None:
        super().__init__(BALL, log, "xyz", "m")

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        log = self.log.recordings[recording]
        place, contact = toss(self.model_under(hypothesis), log.rows, self.every)
        assert log.pose is not None
        measured = log.pose[:, :3]
        return {
            "time": log.time,
            "measured": measured,
            "simulated": place,
            "contact": contact,
        }


def swing(
    model: mujoco.MjModel, commands: Array, start: Array, every: int
) -> tuple[Array, Array]:
    """Simulate the arm; return positions and gravity's torque in each row."""
    data, still = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[:] = start
    track, torque = np.empty_like(commands), np.empty_like(commands)
    for row, command in enumerate(commands):
        track[row] = data.qpos
        still.qpos[:] = data.qpos
        mujoco.mj_forward(model, still)
        torque[row] = still.qfrc_bias
        data.ctrl[:] = command
        mujoco.mj_step(model, data, every)
    return track, torque


def toss(model: mujoco.MjModel, rows: int, every: int) -> tuple[Array, Array]:
    """Throw the ball; return its places and whether it touches the floor."""
    data = mujoco.MjData(model)
    data.qvel[:3] = 0.6, 0.2, 1.0
    place, contact = np.empty((rows, 3)), np.empty(rows, dtype=bool)
    for row in range(rows):
        place[row] = data.qpos[:3]
        mujoco.mj_forward(model, data)
        contact[row] = data.ncon > 0
        mujoco.mj_step(model, data, every)
    return place, contact


def commands(seed: int, seconds: float = SECONDS) -> tuple[Array, Array]:
    """Commands of a moving arm: swings of both joints, with rests; times too."""
    time = np.arange(0.0, seconds, PERIOD)
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.35, 0.7, 2), rng.uniform(0, 6, 2)
    # The angle rests for 1 s and runs on for 3 s.
    phase = np.clip(time % 4.0 - 1.0, 0.0, 3.0) + 3.0 * (time // 4.0)
    return time, 0.7 * np.sin(2 * np.pi * rates * phase[:, None] + phases)


def arm_problem(
    *hidden: AppliedEffect, recordings: int = 3, seconds: float = SECONDS
) -> Arm:
    """An arm whose recordings were made with effects that its model lacks."""
    names, made = ("shoulder", "elbow"), []
    clean = Arm(Log((empty_recording(),), names, names))
    model = clean.model_under(Hypothesis(hidden))
    for seed in range(recordings):
        time, sent = commands(seed, seconds)
        track, _ = swing(model, sent, sent[0], clean.every)
        noise = np.random.default_rng(100 + seed).normal(0.0, NOISE, track.shape)
        name = f"episode {seed}"
        made.append(Recording(name, time, track + noise, command=sent))
    return Arm(Log(tuple(made), names, names))


def write_case(folder: Path, *hidden: AppliedEffect) -> tuple[Path, Path]:
    """Write the arm's model and six recordings of it; return where they lie."""
    logs, model = folder / "logs", folder / "arm.xml"
    logs.mkdir(parents=True)
    model.write_text(ARM)
    for recording in arm_problem(*hidden, recordings=6, seconds=4.0).log.recordings:
        columns = [recording.time[:, None], recording.position, recording.command]
        rows: Array = np.concatenate([np.asarray(c) for c in columns], axis=1)
        header = "time,shoulder,elbow,cmd_shoulder,cmd_elbow"
        file = logs / f"{recording.name}.csv"
        np.savetxt(file, rows, delimiter=",", header=header, comments="")
    return model, logs


def empty_recording() -> Recording:
    time, sent = commands(0, 0.1)
    return Recording("none", time, np.zeros_like(sent), command=sent)


def ball_problem(stiffness: float = -800.0) -> Ball:
    """A ball that bounces otherwise than its model does."""
    model = mujoco.MjModel.from_xml_string(BALL)
    model.geom_solref[1, 0] = stiffness
    time = np.arange(0.0, 2.0, PERIOD)
    place, _ = toss(model, len(time), round(PERIOD / model.opt.timestep))
    place += np.random.default_rng(0).normal(0.0, NOISE, place.shape)
    pose = np.concatenate([place, np.tile([1.0, 0, 0, 0], (len(time), 1))], axis=1)
    return Ball(Log((Recording("toss", time, pose=pose),), body="ball"))


def last_state(steps: Generator[State, None, State]) -> State:
    """Return what a step of a search returns in the end."""
    while True:
        try:
            next(steps)
        except StopIteration as ended:
            return ended.value
