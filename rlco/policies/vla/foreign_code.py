"""Loading somebody else's model without running code of theirs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from transformers import dynamic_module_utils
from transformers.integrations import hub_kernels


@contextmanager
def no_foreign_code() -> Iterator[None]:
    """Keep transformers from running code that a model's files bring or name.

    Where a tokenizer or a configuration has Python of its own, transformers asks at
    the terminal whether to run it; here it raises ``ValueError``. Nor does it fetch
    attention kernels, which a configuration may name on the Hub.
    """
    kept = dynamic_module_utils.TIME_OUT_REMOTE_CODE, hub_kernels.get_kernel
    dynamic_module_utils.TIME_OUT_REMOTE_CODE = 0
    hub_kernels.get_kernel = _no_kernel
    try:
        yield
    finally:
        dynamic_module_utils.TIME_OUT_REMOTE_CODE, hub_kernels.get_kernel = kept


def _no_kernel(name: str, *_: Any, **__: Any) -> None:
    raise ImportError(f"the kernel {name!r} is code of the Hub, which never runs")
