"""Which version of the code a script runs: a hash that wording does not change."""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import rlco
from rlco.errors import DataError
from rlco.files import reading
from rlco.files.reading import reason

#: The folder that holds the package rlco.
ROOT = Path(rlco.__file__).parent.parent

#: Bytes of a file: its tree takes some hundred times as many.
_LONGEST = 2_000_000
_ADVICE = "correct it, or give another one"
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Code:
    """The code of a script, as it was when it was read.

    Attributes:
        script: The script.
        version: See `code_version`.
        stamps: When each of its files was written last, and how long it is.
    """

    script: Path
    version: str
    stamps: Mapping[Path, tuple[int, int]]

    def has_changed(self) -> bool:
        """Return whether the script's code is another one now."""
        # To hash it takes seconds of a processor, to look at its files does not.
        if all(_stamp(path) == stamp for path, stamp in self.stamps.items()):
            return False
        try:
            return code_version(self.script) != self.version
        except (DataError, OSError):  # what cannot be read now could be, before
            return True


def read_code(script: Path) -> Code:
    """Return the code that a script runs now.

    Raises:
        DataError: One of its files cannot be read as Python.
    """
    files = sources(script)
    stamps = {path: _stamp(path) for path in files.values()}
    return Code(script, _version(files), stamps)


def code_version(script: Path) -> str:
    """Return a hash of a script and of all that it may import from rlco or beside it.

    Comments, docstrings and layout do not enter; names, constants and messages do. A
    module that imports others by names made at run time brings its whole package.
    Other libraries do not enter: their versions are pinned, and cells name them.

    Args:
        script: The Python file that is started.

    Returns:
        64 hexadecimal digits.

    Raises:
        DataError: One of its files cannot be read as Python.
    """
    return _version(sources(script))


def check_python(script: Path) -> None:
    """Check that a script can be read as Python; what it imports is not looked at.

    Raises:
        DataError: It cannot.
    """
    _parsed(_content(script), script)


def _version(files: Mapping[str, Path]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        digest.update(f"{name}\n{_parsed(_content(path), path).text}\n".encode())
    return digest.hexdigest()


def sources(script: Path) -> dict[str, Path]:
    """Return the files that a script may run, by the names they have in the hash.

    Found without running anything: import statements are followed, also those inside
    functions, to packages of rlco and to modules beside the script.
    """
    roots = (script.parent.resolve(), ROOT)
    # Both asked once: most of what is imported lies in neither.
    beside = {path.stem for path in roots[0].iterdir()}
    package: dict[str, Path] = {}
    if "rlco" not in beside:  # which Python would import instead
        package = {_module(path): path for path in (ROOT / "rlco").rglob("*.py")}
    waiting, found = [script.resolve()], dict[str, Path]()
    known, modules = {*waiting}, set[str]()
    while waiting:
        path = waiting.pop()
        found[_name(path, roots)] = path
        content = _content(path)
        fresh = _imported(content, path, roots) - modules
        modules |= fresh
        further = {package[module] for module in fresh & package.keys()}
        for module in fresh:
            if module.partition(".")[0] in beside:
                further |= {*_files(module, roots[0])}
        if _parsed(content, path).by_name:
            further |= {*path.parent.rglob("*.py")}
        waiting += further - known
        known |= further
    return found


def _stamp(path: Path) -> tuple[int, int]:
    try:
        known = path.stat()
    except OSError:
        return 0, 0
    return known.st_mtime_ns, known.st_size


@functools.cache
def _name(path: Path, roots: tuple[Path, ...]) -> str:
    """Name a file by where it lies below a root: a checkout may be anywhere."""
    return next(str(path.relative_to(r)) for r in roots if path.is_relative_to(r))


@functools.cache
def _module(path: Path) -> str:
    """Return the dotted name of a file of rlco."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _files(module: str, folder: Path) -> list[Path]:
    """Return the file of a module in a folder, if it is there."""
    base = folder.joinpath(*module.split("."))
    both = (base.with_name(f"{base.name}.py"), base / "__init__.py")
    return [path for path in both if path.is_file()][:1]


Import = ast.Import | ast.ImportFrom


@dataclass(frozen=True)
class _Parsed:
    """What of a file's syntax counts.

    Attributes:
        imports: Its import statements.
        by_name: Whether it imports by names made later, too.
        text: Its tree, without docstrings.
    """

    imports: tuple[Import, ...]
    by_name: bool
    text: str


def _content(path: Path) -> bytes:
    with reading(path, advice=_ADVICE):
        if (size := path.stat().st_size) > _LONGEST:
            raise DataError(
                f"file {str(path)!r} is of {size} bytes, and at most {_LONGEST} are "
                f"read; {_ADVICE}."
            )
        return path.read_bytes()


# Scripts of an experiment share most of their files: each is parsed once.
@functools.cache
def _parsed(content: bytes, path: Path) -> _Parsed:
    """Parse a file.

    Raises:
        DataError: It is no Python, or nested too deeply to be looked through.
    """
    try:
        return _parse(content, path)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise DataError(
            f"file {str(path)!r} cannot be read as Python ({reason(error)}); {_ADVICE}."
        ) from error


def _parse(content: bytes, path: Path) -> _Parsed:
    tree = ast.parse(content, str(path))
    nodes = list(ast.walk(tree))
    imports = tuple(node for node in nodes if isinstance(node, Import))
    for node in nodes:
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return _Parsed(imports, any(map(_imports_by_name, nodes)), ast.dump(tree))


@functools.cache
def _imported(content: bytes, path: Path, roots: tuple[Path, ...]) -> frozenset[str]:
    """Return the dotted names that a file imports, the packages above them too."""
    found = set[str]()
    for node in _parsed(content, path).imports:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            base = _base(node, path, roots)
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        for name in names:
            parts = name.split(".")
            found |= {".".join(parts[:end]) for end in range(1, len(parts) + 1)}
    return frozenset(found)


def _base(node: ast.ImportFrom, path: Path, roots: tuple[Path, ...]) -> str:
    """Return the absolute name that a ``from`` statement imports from."""
    if not node.level:
        return node.module or ""
    package = Path(_name(path, roots)).parts[: -node.level]
    return ".".join([*package, *([node.module] if node.module else [])])


def _imports_by_name(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and getattr(
        node.func, "attr", getattr(node.func, "id", "")
    ) in ("import_module", "__import__")
