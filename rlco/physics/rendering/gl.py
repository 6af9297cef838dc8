"""The only OpenGL context of a process, in a thread of its own.

A context belongs to the thread in which it is current. In its own thread it cannot
conflict with another renderer in the process, such as robosuite's, which makes its
context current once and assumes that it remains so. Cameras can also be used from any
thread. All cameras share it, because shaders are compiled in each new context, which
takes a quarter of a second.
"""

from __future__ import annotations

import ctypes
import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco

from rlco.errors import RenderingError

# The minimum that shows whether OpenGL works: some libraries fail only here.
_PROBE = """<mujoco><visual>
<quality shadowsize="0" offsamples="0"/><global offwidth="8" offheight="8"/>
</visual></mujoco>"""
_here = threading.local()


def run[**P, R](function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a function in the thread of the context, and return its result.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
    """
    if hasattr(_here, "context"):  # the garbage collector may run in that thread, too
        return function(*args, **kwargs)
    return _thread().submit(function, *args, **kwargs).result()


@functools.cache
def _thread() -> ThreadPoolExecutor:
    thread = ThreadPoolExecutor(1, thread_name_prefix="OpenGL")
    try:
        thread.submit(_make).result()
    except RenderingError:
        thread.shutdown()
        raise
    return thread


# A forked process has the memory of its parent, but not its threads.
os.register_at_fork(after_in_child=_thread.cache_clear)


def _make() -> None:
    # The choice that MuJoCo made at import; robosuite sets MUJOCO_GL afterwards.
    kind = getattr(mujoco, "GLContext", None)
    if kind is None:
        raise RenderingError("disabled", "rendering is switched off")
    try:
        # This is the size of a window; cameras render to buffers of their own.
        context = kind(8, 8)
        context.make_current()
        probe = mujoco.MjModel.from_xml_string(_PROBE)
        mujoco.MjrContext(probe, mujoco.mjtFontScale.mjFONTSCALE_50).free()
    # The exception for a missing library differs by backend and by library.
    except (
        ImportError,
        AttributeError,
        RuntimeError,
        OSError,
        mujoco.FatalError,
    ) as error:
        backend = kind.__module__.rpartition(".")[-1]
        raise RenderingError(backend, str(error)) from error
    # Never freed by Python: EGL reports an error if it has already ended at exit.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(context))
    _here.context = context
