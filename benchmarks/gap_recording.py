"""Recordings of a plant: commands in, what its encoders tell out.

A plain loop over MuJoCo's steps. What a compiled model cannot hold acts here: on the
way of the commands, at each step, and in the encoders. Independent of rlco, see
`gap_plant`.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from gap_arms import Array
from gap_motions import Motion
from gap_plant import Hidden, Plant

Random = np.random.Generator


@dataclass(frozen=True)
class Recorded:
    """One episode, rows at the frames' times.

    Attributes:
        position: As the encoders tell, without noise, (frames, joints) [rad].
        velocity: Of the joints, (frames, joints) [rad/s].
        torque: Of the actuators, (frames, joints) [N m].
    """

    position: Array
    velocity: Array
    torque: Array


def goals(
    plant: Plant,
    commands: Array,
    fps: float,
    random: Random,
    times: Array | None = None,
) -> Array:
    """Return what reaches each servo at each physics step, (steps, joints) [rad].

    Commands are sent at `fps`, or at these times [s], and held. On their way, in this
    order: some are lost, each is late by its own time, all by one, read once a period,
    limited in speed, smoothed, and at last the transmission's play and the encoder's
    zero and scale come between.
    """
    step = plant.model.opt.timestep
    time = step * np.arange(int(np.ceil(len(commands) / fps / step - 1e-6)) + 1)
    for effect in plant.of("dropped_commands"):
        kept = random.random(len(commands)) >= effect["share"]
        kept[0] = True
        commands = commands[
            np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))
        ]
    sent = time.copy()
    for effect in plant.of("control_rate"):
        sent = np.floor(sent / effect["period"] + 1e-6) * effect["period"]
    for effect in plant.of("command_delay"):
        sent = sent - effect["delay"]
    for effect in plant.of("random_delay"):
        at = np.arange(len(commands)) / fps if times is None else times
        times = _arrivals(at, effect, random)
    if times is None:
        frames = np.floor(sent * fps + 1e-6).astype(int)
        goal = commands[np.clip(frames, 0, len(commands) - 1)].astype(float)
    else:
        # One that arrives within a step acts for the rest of it: ten parts suffice.
        parts = sent[:, None] + step * (np.arange(10) + 0.5) / 10
        frames = np.searchsorted(times, parts, side="right") - 1
        goal = commands[np.clip(frames, 0, len(commands) - 1)].mean(axis=1)
    for column, joint in enumerate(plant.joints):
        for effect in plant.hidden:
            if effect.target != joint:
                continue
            line = goal[:, column]
            match effect.name:
                case "velocity_limit":
                    _limit_speed(line, effect["limit"] * step)
                case "actuator_lag":
                    _smooth(line, 1.0 - np.exp(-step / effect["time_constant"]))
                case "backlash":
                    _play(line, 0.5 * effect["width"])
        for effect in plant.hidden:
            if effect.target == joint and effect.name == "encoder_scale":
                goal[:, column] /= effect["factor"]
            if effect.target == joint and effect.name == "joint_offset":
                goal[:, column] -= effect["offset"]
    return goal


def _arrivals(sent: Array, effect: Hidden, random: Random) -> Array:
    """Return when each message arrives, late by a gamma-distributed time, (sent,) [s].

    A gamma distribution of shape k and scale s has mean k s and variance k s^2. The
    order is kept, as in one stream: a message waits for those sent before it.
    """
    mean, spread = effect["mean"], effect["spread"]
    late = random.gamma((mean / spread) ** 2, spread**2 / mean, len(sent))
    return np.asarray(np.maximum.accumulate(sent + late))


def _limit_speed(goal: Array, largest: float) -> None:
    now = goal[0]
    for step, wanted in enumerate(goal):
        now = goal[step] = min(max(wanted, now - largest), now + largest)


def _smooth(goal: Array, part: float) -> None:
    now = goal[0]
    for step, wanted in enumerate(goal):
        now = goal[step] = now + part * (wanted - now)


def _play(goal: Array, half: float) -> None:
    now = goal[0]
    for step, wanted in enumerate(goal):
        if wanted > now + half:
            now = wanted - half
        elif wanted < now - half:
            now = wanted + half
        goal[step] = now


def record(
    plant: Plant,
    commands: Array,
    fps: float,
    random: Random,
    session: tuple[float, float] = (0.0, 1.0),
    times: Array | None = None,
) -> Recorded:
    """Send commands to a plant that rests at the first of them.

    Args:
        plant: What moves.
        commands: One row a frame, (frames, joints) [rad].
        fps: Frames a second [1/s].
        random: What decides on losses and pushes.
        session: Where in the whole session the episode begins and ends, in [0, 1]:
            what drifts, drifts over the session.
        times: When each row is read, and its command sent, (frames,) [s]; None for
            even ones.
    """
    model, joints = plant.model, plant.joints
    data = mujoco.MjData(model)
    goal = goals(plant, commands, fps, random, times)
    places = [model.joint(joint).qposadr[0] for joint in joints]
    dofs = [plant.dofs[joint] for joint in joints]
    data.qpos[places] = _true(plant, commands[0])
    data.ctrl[:] = goal[0]
    mujoco.mj_forward(model, data)
    act = _Forces(plant, goal, session, random)
    steps = len(goal)
    position, velocity = np.empty((2, steps, len(joints)))
    torque = np.empty((steps, len(joints)))
    springs = [(joints.index(j), adr) for j, adr in plant.springs.items()]
    spring_dofs = [
        (joints.index(j), int(model.joint(f"{j}_spring").dofadr[0]))
        for j in plant.springs
    ]
    for step in range(steps):
        position[step], velocity[step] = data.qpos[places], data.qvel[dofs]
        for column, adr in springs:
            position[step, column] += data.qpos[adr]
        for column, dof in spring_dofs:
            velocity[step, column] += data.qvel[dof]
        torque[step] = data.qfrc_actuator[dofs]
        data.ctrl[:] = goal[step]
        act(data, step)
        mujoco.mj_step(model, data)
    # The next episode begins with the plant's own friction, not with the last step's.
    model.dof_frictionloss[:] = act.friction
    told = _told(plant, position)
    time = np.arange(len(commands)) / fps if times is None else times
    clock = model.opt.timestep * np.arange(steps)

    def at_frames(signal: Array) -> Array:
        return np.stack([np.interp(time, clock, line) for line in signal.T], axis=1)

    return Recorded(at_frames(told), at_frames(velocity), at_frames(torque))


def _told(plant: Plant, position: Array) -> Array:
    """Return what the encoders tell of true positions, (..., joints) [rad]."""
    told = position.copy()
    for column, joint in enumerate(plant.joints):
        for effect in plant.hidden:
            if effect.target != joint:
                continue
            if effect.name == "joint_offset":
                told[..., column] += effect["offset"]
            elif effect.name == "encoder_eccentricity":
                turn = position[..., column] + effect["phase"]
                told[..., column] += effect["amplitude"] * np.sin(turn)
        for effect in plant.of("encoder_scale"):
            if effect.target == joint:
                told[..., column] *= effect["factor"]
    return told


def _true(plant: Plant, told: Array) -> Array:
    """Return positions whose reading is `told`, (joints,) [rad]."""
    true = told.astype(float)
    for _ in range(50):
        true -= _told(plant, true) - told
    return true


class _Forces:
    """What acts before each step: friction that changes, losses, pushes, ripple."""

    def __init__(
        self,
        plant: Plant,
        goal: Array,
        session: tuple[float, float],
        random: Random,
    ) -> None:
        self.plant = plant
        self.friction = plant.model.dof_frictionloss.copy()
        self.session = np.linspace(*session, len(goal))
        self.pushes = _pushes(plant, len(goal), random)
        names = {effect.name for effect in plant.hidden}
        self.idle = not names & {
            "stribeck_friction",
            "load_friction",
            "drive_loss",
            "torque_bias",
            "torque_ripple",
            "cogging",
            "hardening_spring",
            "directional_friction",
            "slow_drift",
            "encoder_eccentricity",
            "external_push",
        }

    def __call__(self, data: mujoco.MjData, step: int) -> None:
        """Write friction, forces and goals for the next step."""
        if self.idle:
            return
        model = self.plant.model
        # Friction follows the forces of the step before, as on any engine.
        carried = np.abs(data.qfrc_actuator + data.qfrc_applied + data.qfrc_bias)
        data.qfrc_applied[:] = 0.0
        friction = self.friction.copy()
        for effect in self.plant.hidden:
            dof = self.plant.dofs.get(effect.target or "", -1)
            # All joints are hinges: position and degree of freedom share a number.
            angle = data.qpos[dof] if dof >= 0 else 0.0
            match effect.name:
                case "stribeck_friction":
                    ratio = data.qvel[dof] / effect["speed"]
                    friction[dof] += effect["static"] * np.exp(-(ratio**2))
                case "load_friction":
                    friction[dof] += effect["ratio"] * carried[dof]
                case "drive_loss":
                    lost = _lost(model, data, str(effect.target), effect["loss"])
                    data.qfrc_applied[dof] -= lost
                case "torque_bias":
                    data.qfrc_applied[dof] += effect["torque"]
                case "torque_ripple":
                    turn = effect["count"] * angle + effect["phase"]
                    data.qfrc_applied[dof] += effect["amplitude"] * np.sin(turn)
                case "cogging":
                    turn = effect["count"] * angle + effect["phase"]
                    wave = np.sin(turn) + 0.5 * np.sin(2 * turn)
                    data.qfrc_applied[dof] += effect["amplitude"] * wave
                case "hardening_spring":
                    away = angle - effect["rest"]
                    data.qfrc_applied[dof] -= effect["hardening"] * away**3
                case "directional_friction":
                    friction[dof] += effect["frictionloss"]
                    data.qfrc_applied[dof] += effect["torque"]
                case "slow_drift":
                    part = 2 * self.session[step] - 1
                    data.qfrc_applied[dof] += effect["amplitude"] * part
                case "encoder_eccentricity":
                    wave = np.sin(angle + effect["phase"])
                    servo = model.actuator(effect.target).id
                    data.ctrl[servo] -= effect["amplitude"] * wave
        model.dof_frictionloss[:] = friction
        if len(self.pushes):
            data.qfrc_applied += self.pushes[step]


def _lost(model: mujoco.MjModel, data: mujoco.MjData, joint: str, loss: float) -> float:
    """Return the torque that a servo wants and loses: T becomes T / (1 + loss |T|)."""
    servo = model.actuator(joint).id
    dof, adr = model.joint(joint).dofadr[0], model.joint(joint).qposadr[0]
    pull = model.actuator_gainprm[servo, 0] * data.ctrl[servo]
    pull += model.actuator_biasprm[servo, 1] * data.qpos[adr]
    pull += model.actuator_biasprm[servo, 2] * data.qvel[dof]
    if model.actuator_forcelimited[servo]:
        pull = np.clip(pull, *model.actuator_forcerange[servo])
    return float(pull - pull / (1.0 + loss * abs(pull)))


def _pushes(plant: Plant, steps: int, random: Random) -> Array:
    """Return torques of knocks from outside, (steps, dofs) [N m]."""
    total = np.zeros((steps if plant.of("external_push") else 0, plant.model.nv))
    for effect in plant.of("external_push"):
        width = int(effect["seconds"] / plant.model.opt.timestep)
        shape = np.sin(np.pi * np.arange(width) / width)
        for _ in range(int(effect["knocks"])):
            start = random.integers(0, max(1, steps - width))
            size = random.choice([-1.0, 1.0]) * effect["amplitude"]
            total[start : start + width, plant.dofs[str(effect.target)]] += size * shape
    return total


def read_out(recorded: Recorded, motion: Motion, random: Random) -> dict[str, Array]:
    """Return what is logged: noise, rounding, and velocities where they are logged."""
    shape = recorded.position.shape
    state = recorded.position + motion.noise * random.standard_normal(shape)
    if motion.quantum:
        state = np.round(state / motion.quantum) * motion.quantum
    logged = {"observation.state": state}
    if motion.velocity:
        noise = 10 * motion.noise * random.standard_normal(shape)
        logged["observation.velocity"] = recorded.velocity + noise
    return logged
