"""Demonstrations are refused where a task's robot could not execute them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rlco.data import DemoWriter, load_task_demos
from rlco.errors import DataError
from rlco.physics.spec.robot import PANDA
from rlco.physics.tasks.push_cube import TASK


def write(path: Path, largest: tuple[float, ...]) -> Path:
    """Write one episode an entry, whose third action number reaches so far."""
    with DemoWriter(
        path,
        fps=20,
        state_names=PANDA.state_names,
        environment_state_names=TASK.environment_state_names,
        action_names=PANDA.action_names,
    ) as writer:
        for peak in largest:
            for share in (0.0, -0.5, 1.0, 0.5):
                action = np.full(7, 0.25, np.float32)
                action[2] = share * peak
                writer.add_frame(
                    state=np.zeros(7, np.float32),
                    environment_state=np.zeros(12, np.float32),
                    action=action,
                    task=TASK.instructions[0],
                )
            writer.save_episode()
    return path


def test_actions_in_another_unit_are_refused_with_their_range(tmp_path: Path) -> None:
    data = write(tmp_path / "degrees", (1.0, 80.0))
    with pytest.raises(DataError) as caught:
        load_task_demos(data, TASK, chunk=2)
    # Of the second episode's 0, -40, 80 and 40 three are beyond the limits.
    for word in ("from -40 to 80", "'tool.dz'", "number 2", "3 of 8", "[-1, 1]"):
        assert word in str(caught.value)
    assert len(load_task_demos(data, TASK, chunk=2, episodes=[0]).frames()) == 4


def test_what_rounding_adds_is_taken(tmp_path: Path) -> None:
    data = write(tmp_path / "rounded", (1.0 + 1e-6,))
    assert len(load_task_demos(data, TASK, chunk=2).frames()) == 4
