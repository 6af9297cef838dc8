"""Copies between arrays in compiled code.

In compiled functions ``a[2:5] = b`` brings along what writes the shapes of arrays as
text, for the message of an error that cannot happen here: a fifth of the time that all
of rlco's functions took to compile. These copy and check nothing.
"""

from __future__ import annotations

from typing import Any

from rlco.physics.mj.compiling import inner


@inner
def copy_into(out: Any, start: int, values: Any) -> None:
    """Write ``out[start : start + n] = values``, values (n,); for compiled code."""
    for i in range(values.shape[0]):
        out[start + i] = values[i]


@inner
def copy_matrix(out: Any, values: Any) -> None:
    """Write ``out[:] = values``, both with two axes; for compiled code."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]
