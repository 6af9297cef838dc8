"""What evaluate films is what it counted: the same simulator, stepped by the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from recipe_cases import Assets, refused, start

from rlco import evaluation, videos
from rlco.envs.chunk_env import ChunkEnv
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.tasks.push_cube import TASK
from rlco.policies import load_policy

pytestmark = pytest.mark.slow


def filmed(assets: Assets, out: Path, *options: str) -> Any:
    """Return the frames of the first episode, shape (T, height, width, 3)."""
    given = [f"policy={assets.sft / 'policy'}", "episodes=1", "videos=1"]
    start("evaluate", *given, *options, f"out={out}")
    (video,) = (out / "videos").iterdir()
    return imageio.imread(video, plugin="pyav").astype(float)


@pytest.mark.usefixtures("rendering")
@pytest.mark.thorough
def test_the_films_show_the_effects(assets: Assets, tmp_path: Path) -> None:
    effects = tmp_path / "effects.yaml"
    # The arm gives way to it at once.
    write_effects(effects, [AppliedEffect("torque_bias", "joint2", {"torque": 30.0})])
    plain = filmed(assets, tmp_path / "plain")
    other = filmed(assets, tmp_path / "other", f"effects={effects}")
    assert plain.shape == other.shape
    assert np.abs(other - plain)[0].mean() < 0.5  # the same start
    assert np.abs(other - plain)[-1].mean() > 3.0


@pytest.mark.thorough
@pytest.mark.usefixtures("rendering")
def test_the_films_are_stepped_by_the_backend(
    assets: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[ChunkEnv] = []
    make_env = evaluation.make_env

    # Both backends move the same, so that no frame could tell them apart.
    def noted(*args: Any, **options: Any) -> ChunkEnv:
        made.append(make_env(*args, **options))
        return made[-1]

    for module in (evaluation, videos):
        monkeypatch.setattr(module, "make_env", noted)
    filmed(assets, tmp_path / "out", "backend=robosuite", "seed=3")
    assert [type(env.stepper) for env in made] == [RobosuiteStepper] * 2
    assert [env._seed for env in made] == [evaluation.final_states_seed(3)] * 2


SLOW_TASK = """
from dataclasses import replace
from rlco.physics.tasks.push_cube import TASK as FAST
TASK = replace(FAST, name="slow", control_frequency=10)
"""


@pytest.mark.thorough
@pytest.mark.usefixtures("rendering")
def test_a_film_is_of_the_tasks_rate_and_may_have_an_odd_size(
    assets: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "slow_task.py").write_text(SLOW_TASK)
    monkeypatch.syspath_prepend(str(tmp_path))
    policy, _ = load_policy(assets.sft / "policy")
    path = tmp_path / "film.mp4"
    film = videos.record_video(
        policy, "slow_task:TASK", "sim", path, chunk=policy.chunk, image_size=(61, 83)
    )
    shown = imageio.imread(path, plugin="pyav").astype(float)
    assert shown.shape == (len(film.frames), 62, 84, 3)
    assert np.abs(shown[:, :61, :83] - np.stack(film.frames)).mean() < 5.0
    assert film.period == pytest.approx(0.1 * policy.chunk)
    assert imageio.immeta(path, plugin="pyav")["fps"] == pytest.approx(1 / film.period)
    assert film.instruction in TASK.instructions


def test_the_report_says_when_each_frame_was() -> None:
    film = videos.Film([np.zeros((4, 6, 3), np.uint8)] * 10, 0.4, "push it")
    figure = film.strip("sim", "sft")
    # Every second frame of ten.
    times = [axes.get_title() for axes in figure.axes]
    assert times == ["0.0 s", "0.8 s", "1.6 s", "2.4 s", "3.2 s"]


@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_a_task_that_cannot_be_filmed_is_refused_before_it_is_played(
    assets: Assets, capsys: pytest.CaptureFixture[str], tmp_path: Path, backend: str
) -> None:
    given = [f"policy={assets.sft / 'policy'}", "videos=1", f"backend={backend}"]
    out = tmp_path / "out"
    line = refused(capsys, "evaluate", "task=robosuite:Lift", *given, f"out={out}")
    assert "'robosuite:Lift'" in line
    assert "cannot be filmed" in line
    assert not out.exists()
