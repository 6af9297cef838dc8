"""The command `rlco`, in this checkout and from a wheel in another environment."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from rlco import cli
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import write_effects

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "docs" / "example"


def test_the_list_is_of_all_recipes(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["list"])
    lines = capsys.readouterr().out.splitlines()
    files = sorted(path.stem for path in (ROOT / "recipes").glob("*.py"))
    assert [line.split()[0] for line in lines] == files
    assert all(line.endswith(".") and len(line.split()) > 4 for line in lines)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["quickstar"], "(did you mean 'quickstart'?)"),
        (["nothing-like-it"], "recipes are align, check_expert, close_loop,"),
        (["list", "all"], "rlco list takes no arguments, not 'all'"),
        (["copy"], "takes the name of one recipe, not 0 arguments"),
        (["copy", "sfd"], "(did you mean 'sft'?)"),
        (["sft", "updatez=3"], "did you mean 'updates'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_use_ends_with_a_sentence_and_status_2(
    given: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(given)
    assert end.value.code == 2
    assert said in capsys.readouterr().err


def test_a_copied_recipe_runs_and_is_not_overwritten(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    cli.main(["copy", "sft"])
    copied = tmp_path / "sft.py"
    copied.write_text(copied.read_text().replace("Stage I", "My stage"))
    command = [sys.executable, "sft.py", "help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "configs: debug" in done.stdout
    with pytest.raises(SystemExit):
        cli.main(["copy", "sft"])
    assert "'sft.py' exists in this folder and is not" in capsys.readouterr().err
    assert "My stage" in copied.read_text()


def test_info_names_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = ["torch>=2.11,<2.12", "numpy<1", "no-such-library>=3"]
    monkeypatch.setattr("rlco.installation.requires", lambda name: wanted)
    with pytest.raises(SystemExit) as end:
        cli.main(["info"])
    said = capsys.readouterr().out
    assert end.value.code == 1
    assert "\ntorch 2.11" in said
    assert "missing: no-such-library; pip install 'no-such-library>=3'" in said
    assert "missing: numpy 2." in said
    assert "pip install 'numpy<1'" in said


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an environment with the wheel alone, which sees the others' packages."""
    folder = tmp_path_factory.mktemp("installed")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    make = [sys.executable, "-m", "venv", "--without-pip", folder / "venv"]
    subprocess.run(make, check=True)
    python = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", wheel], check=True)
    (site,) = (folder / "venv").glob("lib/python3.*/site-packages")
    # A plain path: the file there that makes this checkout importable is not read.
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    copy_compiled(site)
    return folder / "venv" / "bin"


def copy_compiled(site: Path) -> None:
    """Take over what numba has compiled for this checkout, a minute's work.

    It keeps that beside a module, and takes it while the module's size and time are
    those that it was compiled from: a wheel's other files are compiled anew.
    """
    compiled = (ROOT / "rlco").rglob("__pycache__/*.nb?")
    for kept in (*compiled, ROOT / "rlco" / "__pycache__" / "compiled_code.txt"):
        copied = site / kept.relative_to(ROOT)
        copied.parent.mkdir(exist_ok=True)
        shutil.copy2(kept, copied)
    for module in (ROOT / "rlco").rglob("*.py"):
        installed = site / module.relative_to(ROOT)
        if installed.read_bytes() == module.read_bytes():
            shutil.copystat(module, installed)


def run(installed: Path, folder: Path, *argv: str) -> str:
    """Run the installed command in a folder; return what it printed."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command = [str(installed / "rlco"), *argv]
    done = subprocess.run(
        command, cwd=folder, env=kept, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_the_wheel_says_where_it_is(installed: Path, tmp_path: Path) -> None:
    said = run(installed, tmp_path, "info")
    assert f"in {installed.parent}" in said.splitlines()[0]
    assert run(installed, tmp_path, "--version").strip() == rlco_version()


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Write the first four seconds of two of the example's recordings."""
    folder = tmp_path / "logs"
    folder.mkdir()
    for log in sorted((EXAMPLE / "logs").iterdir())[:2]:
        rows = log.read_text().splitlines(keepends=True)[:200]
        (folder / log.name).write_text("".join(rows))
    return folder


def test_the_wheel_checks_an_effect(
    installed: Path, logs: Path, tmp_path: Path
) -> None:
    late = AppliedEffect("command_delay", None, {"delay": 0.036})
    write_effects(tmp_path / "late.yaml", [late])
    given = [f"model={EXAMPLE / 'arm.xml'}", f"data={logs}", "check=late.yaml"]
    run(installed, tmp_path, "find_gap", *given, "out=check")
    found = json.loads((tmp_path / "check" / "check.json").read_text())
    assert all(
        after < 0.4 * before
        for before, after in zip(found["before"], found["after"], strict=True)
    )


@pytest.mark.thorough
def test_the_wheel_finds_what_the_example_lacks(
    installed: Path, logs: Path, tmp_path: Path
) -> None:
    given = [f"model={EXAMPLE / 'arm.xml'}", f"data={logs}", "out=gap_report"]
    run(installed, tmp_path, "find_gap", *given, "film=false")
    report = json.loads((tmp_path / "gap_report" / "report.json").read_text())
    found = {one["name"]: one["parameters"] for one in report["effects"]}
    assert report["verdict"] == "named"
    assert set(found) == {"command_delay", "payload"}
    assert found["command_delay"]["delay"]["value"] == pytest.approx(0.036, abs=5e-4)
    assert found["payload"]["mass"]["value"] == pytest.approx(0.35, rel=0.03)
    assert found["payload"]["x"]["value"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.thorough
def test_the_wheel_runs_the_quickstart(installed: Path, tmp_path: Path) -> None:
    given = ("quickstart", "config=debug", "methods=[sft]", "film=false", "out=run")
    said = run(installed, tmp_path, *given)
    assert "report: run/report.html" in said
    origin = json.loads((tmp_path / "run" / "run.json").read_text())
    assert origin["command"] == shlex.join(("rlco", *given))


def rlco_version() -> str:
    import rlco

    return rlco.__version__
