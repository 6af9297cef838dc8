"""The interface of backends: N worlds of a task, stepped by chunks of actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.spec.task import Array, InitialState, SceneState

OnDivergence = Literal["raise", "mark"]
# Values beyond this are as invalid as NaN, as in MuJoCo (its mjMAXVAL).
TOO_LARGE = 1e10


class Stepper(Protocol):
    """A backend: N worlds of a task's model."""

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""

    def model_of(self, number: int) -> mujoco.MjModel:
        """Return one world's own model; valid until the next call."""

    @property
    def model_addresses(self) -> NDArray[np.int64]:
        """Addresses of the worlds' models, which compiled code reads, (N,)."""

    def run_over(
        self, kernel: Callable[..., None], count: int, *arguments: Any
    ) -> None:
        """Run a compiled loop, ``kernel(first, last, *arguments)``, over [0, count)."""

    def patch(
        self, which: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> None:
        """Give worlds their own values of arrays that only drawing reads, unchecked.

        Args:
            which: Indices of worlds, shape (R,).
            values: By `rlco.physics.mj.model_struct.get_array`'s names, of the model's
                shape with a leading axis (R,).
        """

    @property
    def data(self) -> Sequence[object]:
        """MuJoCo's state of each world."""

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Mask of the worlds that have diverged since their reset, shape (N,)."""

    def reset(
        self,
        initial: list[InitialState],
        which: NDArray[np.int64] | None = None,
        drawn: Sequence[int] | None = None,
    ) -> SceneState:
        """Start episodes in the worlds `which`; return all states, (N,).

        Args:
            initial: Their initial states.
            which: Indices of worlds, (R,).
            drawn: The parameter set of the domain's sample that each of them has from
                now on.
        """

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute chunks (N, H, A); return states (N, H + 1)."""

    def reported_state(self) -> SceneState:
        """Return the current state as the robot's encoders report it, (N,)."""


@dataclass(frozen=True)
class BatchStep:
    """The result of one action chunk in N worlds.

    Attributes:
        observations: robosuite's, by name, each shape (N, K).
        reward: Of each control step, shape (N, H); 0 where none was executed.
        success: robosuite's check of the current state, shape (N,).
        diverged: Mask of the worlds that have diverged since their reset, shape (N,).
    """

    observations: dict[str, Array]
    reward: Array
    success: NDArray[np.bool_]
    diverged: NDArray[np.bool_]


def check_actions(actions: Array) -> None:
    """Refuse action chunks (N, H, A) that contain NaN or infinity.

    MuJoCo would warn, command zero torques and continue.

    Raises:
        RlcoError: If a value is not finite.
    """
    bad = np.flatnonzero(~np.isfinite(actions).all(axis=(1, 2)))
    if bad.size:
        raise RlcoError(
            f"the actions of environments {bad.tolist()} are NaN or infinite; check "
            "the policy that produces them."
        )
