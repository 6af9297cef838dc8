"""Models made to fill a memory: compiled elsewhere, within limits."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlco.errors import RlcoError
from rlco.gap import trial
from rlco.gap.model import load_model

BODY = "<body><joint name='j'/><geom size='1'/></body>"
FIELD = (
    "<mujoco><asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/>"
    f"</asset><worldbody><geom type='hfield' hfield='h'/>{BODY}</worldbody></mujoco>"
)
COPIES = (
    "<mujoco><worldbody><replicate count='100000000' offset='1 0 0'>"
    f"{BODY}</replicate></worldbody></mujoco>"
)


@pytest.mark.parametrize("xml", [FIELD, COPIES])
def test_a_model_of_a_few_words_that_fills_a_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, xml: str
) -> None:
    monkeypatch.setattr(trial, "SECONDS", 5.0)
    file = tmp_path / "model.xml"
    file.write_text(xml)
    with pytest.raises(RlcoError, match=r"takes more than 2.0 GB or 5 s to compile"):
        load_model(file)


def test_a_model_that_is_tried_first_loads_as_any(tmp_path: Path) -> None:
    few = COPIES.replace("100000000", "3")
    assert not trial.is_plain(few)
    file = tmp_path / "model.xml"
    file.write_text(few)
    assert len(load_model(file).joints) == 3


def test_what_mujoco_says_in_the_trial_is_quoted(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_text(COPIES.replace("count='100000000'", "count='x'"))
    with pytest.raises(RlcoError, match=r"does not compile; MuJoCo says: .*count"):
        load_model(file)


def test_a_model_that_is_no_text(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_bytes(b"<mujoco>\xff\xfe</mujoco>")
    with pytest.raises(RlcoError, match="give an MJCF or URDF file"):
        load_model(file)


def test_a_trial_that_is_killed_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the system does where all memory is taken."""
    monkeypatch.setattr(trial, "_CODE", "import os; os.kill(os.getpid(), 9)")
    file = tmp_path / "model.xml"
    file.write_text(COPIES.replace("100000000", "3"))
    with pytest.raises(RlcoError, match=r"takes more than 2\.0 GB"):
        load_model(file)
