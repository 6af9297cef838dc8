"""Recording the scripted expert: what is made anew, and what is left as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import reach
from numpy.typing import NDArray

from rlco.data import load_demos, record_demonstrations, record_once
from rlco.errors import OutputExistsError, RlcoError
from rlco.physics.spec.task import Array, SceneState
from rlco.physics.tasks import push_cube
from rlco.physics.tasks.demonstrate import ExpertError, demonstrate

pytestmark = pytest.mark.slow


def test_a_recording_that_was_cut_off_is_made_anew(tmp_path: Path) -> None:
    part = tmp_path / "demos.part"
    part.mkdir()
    (part / "half").write_text("written")
    record_once(tmp_path / "demos", "push_cube", "sim", episodes=1, seed=3)
    assert not part.exists()
    demos = load_demos(tmp_path / "demos")
    assert len(demos.meta.episodes) == 1
    assert demos.meta.robot_type == "panda_sim"


def test_effects_that_cannot_be_are_told_before_a_folder_is_made(
    tmp_path: Path,
) -> None:
    effects = tmp_path / "effects.yaml"
    effects.write_text(
        "effects:\n- {name: armature, target: joint1, parameters: {armature: -1.0e6}}\n"
    )
    path = tmp_path / "demos"
    with pytest.raises(RlcoError, match=r"armature=-1e.06 would leave"):
        record_demonstrations(
            path, "push_cube", "sim", episodes=1, seed=0, effects=effects
        )
    assert not path.exists()


def test_a_whole_recording_is_left_as_it_is(tmp_path: Path) -> None:
    there = tmp_path / "demos"
    there.mkdir()
    record_once(there, "push_cube", "sim", episodes=1, seed=3)
    assert list(there.iterdir()) == []
    with pytest.raises(OutputExistsError):
        record_demonstrations(there, "push_cube", "sim", episodes=1, seed=3)


# The reward's goal is 10 cm above the mark; this expert only goes to within 4 cm of it.
def _short_of_it(state: SceneState) -> Array:
    action = reach.expert(state)
    away = reach.gap(state)
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    action[..., :3] *= np.clip((distance - 0.04) / 0.02, 0.0, 1.0)
    return action


SHORT = replace(reach.TASK, name="short", horizon=40, expert=_short_of_it)


@pytest.mark.thorough
def test_an_expert_that_stops_short_is_filmed_and_told_to_aim_beyond(
    tmp_path: Path, rendering: None
) -> None:
    with pytest.raises(RlcoError) as caught:
        record_demonstrations(
            tmp_path / "demos",
            f"{__name__}:SHORT",
            "sim",
            episodes=2,
            seed=3,
            noise=0.0,
        )
    told = str(caught.value)
    film = tmp_path / "demos_episode_0.mp4"
    for words in ("0 of 40", "in episodes 0-39 of seed 3", "aim beyond", str(film)):
        assert words in told
    frames = imageio.imread(film, plugin="pyav")
    assert frames.shape == (40, 240, 320, 3)
    # It moves at first, and stands still in the end.
    change = np.abs(np.diff(frames.astype(float), axis=0)).mean((1, 2, 3))
    assert change[:5].max() > 3 * change[-5:].max()


def test_an_instruction_that_always_fails_is_not_waited_for() -> None:
    def success(state: SceneState) -> NDArray[np.bool_]:
        return state.instruction_id != 2

    two_of_three = replace(push_cube.TASK, horizon=1, success=success)
    with pytest.raises(ExpertError, match=r"0 of .* where it was to 'push the blue"):
        list(demonstrate(two_of_three, "sim", episodes=30, seed=0, hold=0))
