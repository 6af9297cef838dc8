"""The range of actions: what is clipped with a word, and what is refused."""

from __future__ import annotations

import logging

import numpy as np
import numpy.typing as npt

from rlco.errors import RlcoError

_logger = logging.getLogger(__name__)

#: Every number of an action of the simulator's tasks lies in [-LIMIT, LIMIT].
LIMIT = 1.0
#: What rounding may add to it.
TOLERANCE = 1e-3
#: No exploration goes this far: such a number is in another unit.
FAR = 10.0


class ActionRange:
    """Looks at the actions that reach an environment, which clips them.

    Example:
        >>> ActionRange().check([[0.3, 1.0]])
        >>> ActionRange().check([[0.3, -57.0]])
        Traceback (most recent call last):
        ...
        rlco.errors.RlcoError: actions reach from -57 to 0.3, but ...
    """

    def __init__(self) -> None:
        self._silent = False

    def check(self, actions: npt.ArrayLike) -> None:
        """Check actions (..., A); warn once of what is clipped.

        Raises:
            RlcoError: A number is ten times beyond the limits, or more.
        """
        numbers = np.asarray(actions)
        # NaN is for those who step to refuse; it compares as false.
        if not np.abs(numbers).max(initial=0.0) > LIMIT + TOLERANCE:
            return
        low, high = float(numbers.min()), float(numbers.max())
        found = f"actions reach from {low:.4g} to {high:.4g}"
        if max(-low, high) >= FAR:
            raise RlcoError(
                f"{found}, but each number of an action lies in [-1, 1]: these are in "
                "another unit, and clipping would leave -1 and 1 of them; divide them "
                "by the largest move that 1 stands for."
            )
        if not self._silent:
            _logger.warning(
                "%s and are clipped to [-1, 1]; scale them, or clip them where they "
                "are drawn. Later ones are clipped without a word.",
                found,
            )
        self._silent = True
