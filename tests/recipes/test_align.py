"""Alignment of two data sets: who is held out, and what is said of it."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path

import pytest
from align import Config, split, stage_options
from recipe_cases import Assets, refused, start

from rlco.files.indices import index_list
from rlco.reporting.alignment.page import Alignment

pytestmark = pytest.mark.slow


def given(assets: Assets) -> list[str]:
    return [f"sim_demos={assets.sim}", f"real_demos={assets.real}", "updates=2"]


def test_every_real_episode_is_held_out_once_and_never_trained_on(
    assets: Assets,
) -> None:
    config = Config(sim_demos=str(assets.sim), real_demos=str(assets.real), folds=7)
    folds = split(config)
    assert [fold.real_held_out for fold in folds] == ["0", "1"]  # there are only two
    for fold in folds:
        for kept, out in (
            (fold.real, fold.real_held_out),
            (fold.sim, fold.sim_held_out),
        ):
            both = (index_list(kept) or []) + (index_list(out) or [])
            assert sorted(both) == [0, 1]
        options = stage_options(config, fold, "both")
        assert (options.episodes, options.sim_episodes) == (fold.real, fold.sim)


def test_what_is_printed_is_what_the_page_and_the_file_hold(
    assets: Assets, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start("align", *given(assets), f"out={tmp_path / 'out'}")
    said = capsys.readouterr().err
    found = Alignment(**json.loads((tmp_path / "out" / "alignment.json").read_text()))
    page = (tmp_path / "out" / "report.html").read_text()
    assert found.shares.keys() == {"own", "cross", "real_only", "both"}
    assert len(found.by_action["cross"]) == len(found.actions) == 7
    assert (found.sim[1], found.real[1], found.folds) == (1, 2, 2)
    for sentence in found.sentences():
        assert sentence in said
        assert escape(sentence) in page
    first = (tmp_path / "out" / "alignment.json").read_bytes()
    start("align", f"resume={tmp_path / 'out'}")  # nothing is trained again
    assert (tmp_path / "out" / "alignment.json").read_bytes() == first


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("policy=token", ["policy=token", "gaussian", "leave it out"]),
        ("episodes=0", ["real_demos=", "leaves 1 episode", "at least 2"]),
        ("episodes=0-5", ["asks for 2-5", "out of 0-1"]),
    ],
)
def test_what_cannot_be_measured_is_refused_before_a_folder_is_made(
    assets: Assets,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    words: list[str],
) -> None:
    line = refused(capsys, "align", *given(assets), option, f"out={tmp_path / 'out'}")
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()


def alignment(**shares: float) -> str:
    values = {"own": 0.7, "cross": 0.3, "real_only": 0.4, "both": 0.4} | shares
    found = Alignment(values, {}, [], 0.5, ("sim", 5), ("real", 8), 4)
    return " ".join(found.sentences())


def test_the_sentences_follow_the_numbers() -> None:
    assert "part of what it teaches holds" in alignment()
    assert "change imitation little" in alignment()
    assert "holds for the robot" in alignment(cross=0.69)
    assert "other actions" in alignment(cross=-0.2)
    assert "help imitation" in alignment(both=0.6)
    assert "harm imitation" in alignment(both=0.2)


def test_the_nearest_gaps_that_were_mapped_are_named() -> None:
    both = alignment(cross=0.1)
    assert "these teach about as much: push_cube, camera turned by 45 degrees" in both
    assert "push_cube, camera turned by 30 degrees" in both
    one = alignment(cross=-90.0)
    assert "this one teaches about as much: planar, camera turned by 180" in one
