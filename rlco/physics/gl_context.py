"""The one OpenGL context of a process, in a thread of its own.

A context belongs to the thread in which it is current. In a thread of its own it is
never mistaken for that of another renderer in the process, such as robosuite's, which
makes its context current once and then trusts that nobody else does; and cameras can
be used from any thread. One for all cameras, because shaders are compiled anew in
each context, a quarter of a second every time.
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

# The least that shows whether OpenGL works: some libraries fail no sooner.
_PROBE = """<mujoco><visual>
<quality shadowsize="0" offsamples="0"/><global offwidth="8" offheight="8"/>
</visual></mujoco>"""
_here = threading.local()


def run[**P, R](function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a function where the context is current, and return what it returns.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
    """
    if hasattr(_here, "context"):  # the garbage collector can run there, too
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
    # What MuJoCo chose when it was imported; robosuite sets MUJOCO_GL afterwards.
    kind = getattr(mujoco, "GLContext", None)
    if kind is None:
        raise RenderingError("disabled", "rendering is switched off")
    try:
        # The size is that of a window; cameras draw into buffers of their own.
        context = kind(8, 8)
        context.make_current()
        probe = mujoco.MjModel.from_xml_string(_PROBE)
        mujoco.MjrContext(probe, mujoco.mjtFontScale.mjFONTSCALE_50).free()
    # What a missing library raises differs by backend and by library.
    except (
        ImportError,
        AttributeError,
        RuntimeError,
        OSError,
        mujoco.FatalError,
    ) as error:
        backend = kind.__module__.rpartition(".")[-1]
        raise RenderingError(backend, str(error)) from error
    # Never freed by Python: EGL complains about that after its own end at exit.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(context))
    _here.context = context
