"""The gap page's programs, on the small arm."""

from __future__ import annotations

from pathlib import Path

import pytest
from pages import run_python
from small_problems import write_case

from rlco.physics.effects import AppliedEffect

pytestmark = pytest.mark.slow


@pytest.mark.thorough
def test_the_programs_of_the_page_name_what_was_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damping = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})
    write_case(tmp_path, damping)
    monkeypatch.chdir(tmp_path)
    found = run_python("gap.md", "## In a program")
    assert found["finding"].complete
    assert [one.name for one in found["finding"].effects] == ["viscous_damping"]
    assert (tmp_path / "gap_report" / "report.html").is_file()
    assert found["before"].informative[0].target == "shoulder"
    assert [one.name for one in found["verdict"].effects] == ["viscous_damping"]
    assert [one.name for one in found["state"].best.effects] == ["viscous_damping"]
