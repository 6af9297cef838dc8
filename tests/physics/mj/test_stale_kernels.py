"""What numba compiled of older code is forgotten, and only then."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rlco.physics.mj.stale_kernels import forget_stale_kernels


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with a compiled function that calls one of another file."""
    kernels = tmp_path / "physics" / "native"
    (kernels / "__pycache__").mkdir(parents=True)
    (kernels / "outer.py").write_text("from numba import njit\n")
    (kernels / "inner.py").write_text("from rlco.physics.mj.compiling import inner\n1")
    (kernels / "plain.py").write_text("1")
    forget_stale_kernels(tmp_path)
    for kind in ("nbi", "1.nbc"):
        (kernels / "__pycache__" / f"outer.step.{kind}").write_text("compiled")
    return tmp_path


def kept(package: Path) -> int:
    return len(list(package.rglob("*.nb?")))


def test_what_is_compiled_stays_while_the_code_does(package: Path) -> None:
    assert not forget_stale_kernels(package)
    (package / "physics" / "native" / "plain.py").write_text("2")
    assert not forget_stale_kernels(package)
    assert kept(package) == 2


def test_another_inner_function_is_seen_by_what_is_in_its_file(package: Path) -> None:
    path = package / "physics" / "native" / "inner.py"
    before = path.stat()
    path.write_text(path.read_text().replace("1", "2"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # as an archive's
    assert forget_stale_kernels(package)
    assert kept(package) == 0
    assert not forget_stale_kernels(package)
