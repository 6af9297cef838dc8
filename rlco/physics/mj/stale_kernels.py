"""Compiled functions of older code are forgotten: numba would go on with them.

Numba keeps what it has compiled beside the code, and compiles a function anew when its
own file changes; not when one does that it calls a function of. After an update, or an
edit of such a file, a rollout would be one of the old code, without a word.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Where compiled functions are.
_FOLDERS = ("physics", "gap")
_STAMP = "compiled_code.txt"
#: What a file says that holds one.
_MARKS = (b"numba", b"mj.compiling import")


def forget_stale_kernels(root: Path = ROOT) -> bool:
    """Remove what numba has compiled, if a file with a compiled function is another.

    Args:
        root: The package's folder.

    Returns:
        Whether there was another version before. Where nothing can be written, numba
        keeps what it compiles elsewhere, and nothing is done.
    """
    stamp = root / "__pycache__" / _STAMP
    now = _digest(root)
    before = stamp.read_text() if stamp.is_file() else None
    if before == now:
        return False
    try:
        for kept in _kept(root):
            kept.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(now)
    except OSError:  # not ours to write
        return False
    return before is not None


def _digest(root: Path) -> str:
    digest = hashlib.sha256()
    for folder in _FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            content = path.read_bytes()
            if any(mark in content for mark in _MARKS):
                name = path.relative_to(root).as_posix()
                digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _kept(root: Path) -> Iterator[Path]:
    for folder in _FOLDERS:
        for kind in ("*.nbi", "*.nbc"):
            yield from (root / folder).rglob(f"__pycache__/{kind}")
