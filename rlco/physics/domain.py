"""Domains: what differs between the simulator and where a policy will run.

A `Domain` is data. What MJCF can hold (friction, mass, joint friction) changes
the model before it is compiled; the rest (controller stiffness, command delay,
camera frame, sensor noise) acts in every control step, alike in both backends.

``sim`` is the simulator that a user would build. ``stand_in`` is a second
simulator that plays the robot's part where no robot is at hand: nothing measured
in it was measured on a robot. Its numbers were chosen from what real set-ups
show, before any policy was trained, and are not tuned to results.
"""

from __future__ import annotations

from dataclasses import dataclass

from rlco.errors import UnknownNameError


@dataclass(frozen=True)
class Domain:
    """Everything in which one place to run a policy differs from another.

    Attributes:
        name: What results are filed under.
        friction_scale: Times the task's sliding friction of objects on the table.
        mass_scale: Times the task's object masses.
        joint_friction: Added Coulomb friction of each arm joint [N m].
        joint_damping: Added viscous damping of each arm joint [N m s/rad].
        stiffness_scale: Times the stiffness of the operational-space controller;
            its damping follows, so that it stays critically damped.
        command_delay: Control steps between a command and its execution.
        camera_yaw: Turn, about the table's centre, of the frame in which object
            positions are reported [rad].
        camera_shift: Shift of that frame along the base's x and y [m].
        object_noise: Standard deviation of reported object positions [m].
        state_noise: Standard deviation of the reported tool position [m].
        tool_offset: Error of the reported tool height: the mounted fingertip is
            longer than the modelled one [m].
        gripper_offset: Error of the reported gripper opening [m].
        fixture_friction_scale: Times the friction of fixtures' joints, such as a
            drawer's runners.

    Example:
        >>> make_domain("stand_in").command_delay
        1
    """

    name: str
    friction_scale: float = 1.0
    mass_scale: float = 1.0
    joint_friction: float = 0.0
    joint_damping: float = 0.0
    stiffness_scale: float = 1.0
    command_delay: int = 0
    camera_yaw: float = 0.0
    camera_shift: tuple[float, float] = (0.0, 0.0)
    object_noise: float = 0.0
    state_noise: float = 0.0
    tool_offset: float = 0.0
    gripper_offset: float = 0.0
    fixture_friction_scale: float = 1.0


SIM = Domain(
    "sim",
    # A perfect camera would be unfair to every method: simulated ones have noise too.
    object_noise=0.001,
)

STAND_IN = Domain(
    "stand_in",
    # Published friction of wood or plastic on table tops scatters by a third.
    friction_scale=0.7,
    # The same 5 cm cube in beech instead of pine.
    mass_scale=1.4,
    # Identified Coulomb friction of Panda joints is 0.2 to 0.5 N m.
    joint_friction=0.3,
    joint_damping=0.5,
    # Real impedance controllers run softer than simulated ones, for safety.
    stiffness_scale=0.8,
    # 30 to 150 ms between command and motion is common; this is 50 ms at 20 Hz.
    command_delay=1,
    # Extrinsics matched by eye, as in the paper's cousin scenes, not calibrated.
    camera_yaw=0.14,  # 8 degrees
    camera_shift=(0.025, -0.015),
    # Depth noise of a consumer RGB-D camera at about 1 m.
    object_noise=0.003,
    state_noise=0.0005,
    # Another fingertip than the modelled one, and an uncalibrated gripper zero.
    tool_offset=0.006,
    gripper_offset=0.0015,
    # Dry wooden runners that have swollen a little: two times a waxed pair's.
    fixture_friction_scale=2.0,
)

DOMAINS = {domain.name: domain for domain in (SIM, STAND_IN)}


def make_domain(domain: str | Domain) -> Domain:
    """Return the domain of that name; a `Domain` is returned as it is.

    Raises:
        UnknownNameError: If there is no domain of that name.
    """
    if isinstance(domain, Domain):
        return domain
    if domain not in DOMAINS:
        raise UnknownNameError("domain", domain, sorted(DOMAINS))
    return DOMAINS[domain]
