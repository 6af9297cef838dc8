"""An expert is counted from the true state, and every place is checked first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recipe_cases import refused, start

from rlco.physics.spec.task import Array, SceneState
from rlco.physics.tasks.expert_success import expert_success
from rlco.physics.tasks.push_cube import TASK

pytestmark = pytest.mark.slow


def test_steps_count_until_the_task_is_solved_for_good() -> None:
    def late(state: SceneState) -> Array:
        return np.zeros((*state.tool_position.shape[:-1], 7))

    # Solved while the tool is where it starts, whatever the arm does: from step 1 on.
    always = replace(TASK, success=lambda s: s.tool_position[..., 2] > 0, horizon=5)
    played = expert_success(replace(always, expert=late), "sim", episodes=3)
    assert played.solved.tolist() == [True] * 3
    assert played.steps.tolist() == [1.0] * 3
    never = replace(always, success=lambda s: s.tool_position[..., 2] < 0)
    played = expert_success(replace(never, expert=late), "sim", episodes=3)
    assert not played.solved.any()
    assert np.isnan(played.steps).all()


def test_the_recipe_says_where_and_how_often(
    capsys: pytest.CaptureFixture[str],
) -> None:
    start("check_expert", "episodes=2", "domains=[stand_in]", "variations=[colours]")
    shown = capsys.readouterr().err
    assert "push_cube in stand_in: 100.0% [34.2%, 100.0%] of 2 episodes" in shown
    assert "push_cube in stand_in, colours: 100.0%" in shown
    assert "(median)" in shown


def test_what_cannot_be_played_is_refused_before_anything_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for given, words in (
        (["variations=[rain]"], "unknown variation 'rain'"),
        (["variations=[lights]"], "lights changes images alone"),
        (["domains=[]"], "option domains: [] is empty"),
        (["domains=[sim,sim]"], "option domains: ['sim', 'sim'] has one of them twice"),
        (["task=push_cub"], "unknown task 'push_cub'"),
    ):
        assert words in refused(capsys, "check_expert", *given)
