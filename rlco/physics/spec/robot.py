"""A robot as one value: its joints, its gripper and its commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Slices of tool position, tool rotation and gripper, in both states and actions of a
# robot that is commanded by tool motions.
POSITION, ROTATION, GRIPPER = slice(0, 3), slice(3, 6), 6
POSE = slice(POSITION.start, ROTATION.stop)


@dataclass(frozen=True)
class Robot:
    """An arm on a fixed base with a two-finger gripper, commanded by tool motions.

    Attributes:
        name: robosuite's name.
        joints: The arm's joints, as named in the robot's own model.
        arm: robosuite's name of the arm, its controller and its gripper.
        prefixes: robosuite's prefixes of the names of the robot's own parts, of its
            gripper's and of its mount's.
        bases: The bodies that the robot and its mount stand on, in robosuite's model.
        hand: The gripper's body in robosuite's model, which holds a payload.
        base_position: Of the base beside robosuite's table, world frame [m].
        tool_down: Rotation matrix of the tool when the hand points straight down: the
            zero of reported rotations.
        finger_half_range: Half of one finger's travel [m].
        largest_move: The tool's largest commanded translation in a control step [m].
        largest_turn: The tool's largest commanded rotation in a control step [rad].
        state_names: Name of each dimension of `state`: the tool's pose in the frame of
            the base, [m] and [rad], and the distance between the fingers [m].
        action_names: Name of each dimension of an action, in [-1, 1]: a motion of the
            tool as fractions of the largest, and the gripper: positive closes.
    """

    name: str
    joints: tuple[str, ...]
    arm: str
    prefixes: tuple[str, ...]
    bases: tuple[str, ...]
    hand: str
    base_position: tuple[float, float, float]
    tool_down: tuple[tuple[float, float, float], ...]
    finger_half_range: float
    largest_move: float
    largest_turn: float
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]

    @property
    def model_joints(self) -> tuple[str, ...]:
        """Names of the arm's joints in robosuite's model."""
        return tuple(f"{self.prefixes[0]}{joint}" for joint in self.joints)

    @property
    def base(self) -> Array:
        """Position of the base, world frame, (3,), [m]."""
        return np.array(self.base_position)

    @property
    def down(self) -> Array:
        """Rotation of the tool when the hand points straight down, (3, 3)."""
        return np.array(self.tool_down)

    @property
    def widest(self) -> float:
        """Largest distance between the fingers [m]."""
        return 4.0 * self.finger_half_range

    def fingers(self, opening: Array | float) -> tuple[Array | float, Array | float]:
        """Return the positions of the two fingers at a distance between them [m]."""
        half = opening / 2.0
        return half, -half

    def gripper_goal(self, opening: float) -> Array:
        """Return robosuite's command that keeps the fingers at an opening, (2,).

        Example:
            >>> PANDA.gripper_goal(PANDA.widest).tolist()
            [1.0, -1.0]
        """
        side = opening / 2.0 / self.finger_half_range - 1.0
        return np.array([side, -side])


PANDA = Robot(
    name="Panda",
    joints=tuple(f"joint{number}" for number in range(1, 8)),
    arm="right",
    prefixes=("robot0_", "gripper0_", "fixed_mount0_"),
    bases=("robot0_base", "fixed_mount0_base"),
    hand="gripper0_right_right_gripper",
    base_position=(-0.56, 0.0, 0.912),
    tool_down=((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    finger_half_range=0.02,
    # As robosuite configures OSC_POSE.
    largest_move=0.05,
    largest_turn=0.5,
    state_names=(
        *(f"tool.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
        "gripper.opening",
    ),
    action_names=(
        *(f"tool.{axis}" for axis in ("dx", "dy", "dz", "drx", "dry", "drz")),
        "gripper",
    ),
)
