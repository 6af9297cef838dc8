"""What `rlco info` reports: versions, devices, rendering, and what is missing."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

import rlco
from rlco.errors import RenderingError
from rlco.reporting.headless import choose_gl
from rlco.runs.run_folder import commit

#: What else can be installed, and what for.
_OPTIONAL = {
    "lerobot_env_rlco": "rlco's tasks in lerobot-eval; in a checkout, uv sync",
    "lerobot_policy_rlco": "rlco's policies in LeRobot; in a checkout, uv sync",
    "peft": "low-rank adapters of large policies; pip install 'rlco[vla]'",
}


def report() -> Iterator[str]:
    """Yield the report line by line; a line about what is missing begins so.

    Example:
        >>> next(report()).startswith("rlco ")
        True
    """
    where = Path(rlco.__file__).parent
    yield f"rlco {rlco.__version__}, commit {commit(where) or 'unknown'}, in {where}"
    system = f"{platform.system()} {platform.machine()}"
    yield f"Python {platform.python_version()}, {system}"
    yield f"{len(os.sched_getaffinity(0))} CPU cores, {_memory():.0f} GB of memory"
    for text in requires("rlco") or []:
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield _required(requirement)
    for name, use in _OPTIONAL.items():
        try:
            yield f"{name} {version(name)}"
        except PackageNotFoundError:
            yield f"{name}: not installed (optional: {use})"
    yield _gpu()
    yield _rendering()


def _required(requirement: Requirement) -> str:
    wanted = f"pip install '{requirement}'"
    try:
        found = version(requirement.name)
    except PackageNotFoundError:
        return f"missing: {requirement.name}; {wanted}"
    # Builds such as 2.11.0+cpu satisfy what 2.11.0 does.
    if not requirement.specifier.contains(found, prereleases=True):
        return f"missing: {requirement.name} {found} is another version; {wanted}"
    return f"{requirement.name} {found}"


def _memory() -> float:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def _gpu() -> str:
    try:
        import torch
    except ImportError:
        return "GPU: cannot be looked for without torch"
    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    return f"GPU: {', '.join(names) or 'none; the recipes need none'}"


def _rendering() -> str:
    choose_gl()
    try:
        import mujoco

        from rlco.physics.rendering.camera import check_rendering
    except ImportError as error:
        return f"rendering: cannot be tried ({error})"
    try:
        check_rendering()
    except RenderingError as error:
        return (
            "missing: OpenGL, for videos and renderer=opengl (renderer=raster draws "
            f"images without); {error}"
        )
    kind = mujoco.GLContext.__module__.rpartition(".")[-1]
    return f"rendering works, with MUJOCO_GL={kind}"
