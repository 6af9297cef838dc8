"""The version of a script's code: what changes it, and what it covers."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlco.errors import DataError
from rlco.runs.compare.code_version import ROOT, code_version, read_code, sources

SOURCE = '''"""A script."""

import json  # of Python's own
from folder import part


def main(rate: float = 0.5) -> None:
    """Run."""
    import late

    late.act(rate, json, part)
'''


@pytest.fixture
def script(tmp_path: Path) -> Path:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "__init__.py").write_text("")
    (tmp_path / "folder" / "part.py").write_text("from . import sibling\n")
    (tmp_path / "folder" / "sibling.py").write_text("A = 1\n")
    (tmp_path / "folder" / "unused.py").write_text("B = 1\n")
    (tmp_path / "late.py").write_text("from rlco.errors import suggest as act\n")
    path = tmp_path / "script.py"
    path.write_text(SOURCE)
    return path


def test_imports_are_followed_into_functions_packages_and_rlco(script: Path) -> None:
    assert set(sources(script)) == {
        *("script.py", "late.py"),
        *("folder/__init__.py", "folder/part.py", "folder/sibling.py"),
        *("rlco/__init__.py", "rlco/errors.py"),
    }


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""A script."""', '"""Another text."""'),
        ('    """Run."""\n', ""),
        ("  # of Python's own", ""),
        ("late.act(rate, json, part)", "late.act(\n        rate, json, part\n    )"),
    ],
)
def test_wording_and_layout_leave_the_version(script: Path, old: str, new: str) -> None:
    before = code_version(script)
    script.write_text(SOURCE.replace(old, new))
    assert code_version(script) == before


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("script.py", SOURCE.replace("0.5", "0.6")),
        ("folder/sibling.py", "A = 2\n"),
        ("late.py", "from rlco.errors import RlcoError as act\n"),
    ],
)
def test_another_line_of_code_is_another_version(
    script: Path, file: str, text: str
) -> None:
    code = read_code(script)
    (script.parent / file).write_text(text)
    assert code.has_changed()


@pytest.mark.parametrize("file", ["script.py", "late.py"])
def test_code_that_cannot_be_read_any_more_is_another_version(
    script: Path, file: str
) -> None:
    code = read_code(script)
    (script.parent / file).write_text("def (:")
    assert code.has_changed()
    with pytest.raises(DataError, match=f"{file}' cannot be read as Python"):
        code_version(script)
    (script.parent / file).unlink()
    assert code.has_changed()


def test_the_version_does_not_depend_on_the_folder(
    script: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    before = code_version(script)
    moved = script.parent.rename(tmp_path_factory.mktemp("elsewhere") / "here")
    assert code_version(moved / "script.py") == before


def test_a_file_written_again_as_it_was_is_no_change(script: Path) -> None:
    code = read_code(script)
    script.write_text(SOURCE + "\n# a note\n")
    assert not code.has_changed()


def test_a_module_that_imports_by_name_brings_its_package(script: Path) -> None:
    # make_task imports the module of the task that it is asked for.
    (script.parent / "late.py").write_text(
        "from rlco.physics.tasks.make_task import make_task as act\n"
    )
    found = set(sources(script))
    assert "rlco/physics/tasks/push_cube.py" in found
    assert not any(name.startswith("rlco/gap/") for name in found)


@pytest.mark.slow
def test_the_runner_is_no_part_of_what_it_runs() -> None:
    # Otherwise a better table would put every result out of date.
    for path in (ROOT / "recipes").glob("*.py"):
        if path.stem != "compare":
            assert not any("runs/compare/" in name for name in sources(path))


def test_a_package_of_that_name_beside_the_script_is_the_one_that_is_imported(
    script: Path,
) -> None:
    (script.parent / "rlco").mkdir()
    (script.parent / "rlco" / "__init__.py").write_text("")
    (script.parent / "rlco" / "errors.py").write_text("def suggest(): ...")
    found = sources(script)
    assert found["rlco/errors.py"] == script.parent / "rlco" / "errors.py"
    assert {path for path in found.values() if ROOT / "rlco" in path.parents} == set()
