"""A disk that forgets what nobody waited for, and a process that dies at any call."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CALLS = ("fsync", "replace", "rename", "unlink", "mkdir")


class Died(BaseException):
    """The process ends here; nothing in it may do anything more."""


class Disk:
    """Watches the system calls below a folder, and lets the process die at one.

    Attributes:
        calls: How many were made.

    Args:
        folder: What is watched.
        die_at: The call, counted from 1, at which the process dies; None: it does not.
    """

    def __init__(self, folder: Path, die_at: int | None = None) -> None:
        self.folder, self.die_at, self.calls = folder, die_at, 0
        self._content: dict[int, bytes] = {}  # by inode, as of the last fsync
        self._names: dict[int, dict[str, int]] = {}
        self._folders: set[int] = set()
        self._held: list[int] = []  # an inode that is open is given to no other file
        self._sync_folder(folder)

    def watch(self, patch: pytest.MonkeyPatch) -> None:
        """Let the calls of this process pass by here."""
        for name in CALLS:
            patch.setattr(os, name, self._watched(name, getattr(os, name)))

    def _watched(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*given: Any, **named: Any) -> Any:
            self.calls += 1
            if self.die_at is not None and self.calls >= self.die_at:
                raise Died(name)
            if name != "fsync":
                return call(*given, **named)
            path = Path(os.readlink(f"/proc/self/fd/{given[0]}"))
            if path.is_dir():
                self._sync_folder(path)
            else:
                self._content[self._inode(path)] = path.read_bytes()
            return None

        return watched

    def _inode(self, path: Path) -> int:
        descriptor = os.open(path, os.O_RDONLY)
        self._held.append(descriptor)
        return os.fstat(descriptor).st_ino

    def _sync_folder(self, path: Path) -> None:
        inode = self._inode(path)
        self._folders.add(inode)
        self._names[inode] = {one.name: self._inode(one) for one in path.iterdir()}
        self._folders |= {self._inode(p) for p in path.iterdir() if p.is_dir()}

    def after_power_cut(self, target: Path, *, names: str) -> Path:
        """Write down what is left on the disk.

        Args:
            target: A new folder.
            names: ``late``: folders hold the names that were waited for; ``early``: all
                names that were given, also of files whose content was not.
        """
        self._write(target, self._inode(self.folder), self.folder, names)
        return target

    def _write(self, target: Path, inode: int, live: Path, names: str) -> None:
        target.mkdir()
        if names == "early":
            for one in live.iterdir():
                if one.is_dir():
                    self._write(target / one.name, 0, one, names)
                else:
                    (target / one.name).write_bytes(self._kept(one))
            return
        for name, below in self._names.get(inode, {}).items():
            if below in self._folders:
                self._write(target / name, below, live, names)
            else:
                (target / name).write_bytes(self._content.get(below, b""))

    def _kept(self, path: Path) -> bytes:
        """Return a file with zeros in place of what nobody waited for."""
        known, size = self._content.get(self._inode(path), b""), path.stat().st_size
        return known[:size] + bytes(size - len(known[:size]))

    def close(self) -> None:
        """Give up the files that are held."""
        for descriptor in self._held:
            os.close(descriptor)
