"""How much a calibrated model flatters itself where it was fitted."""

from __future__ import annotations

import numpy as np

from rlco.gap.calibrate.fit import Calibration
from rlco.gap.calibrate.numbers import Calibratable
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import correlation_length, seconds_of


def optimism(problem: Calibratable, residual: Array, calibration: Calibration) -> float:
    """Return how much larger a residual is where its model was not fitted.

    A number counts as far as the recordings determine it, and not its prior.
    """
    layout = problem.layout
    series = seconds_of(layout) * len(layout.channels) + layout.channel
    scaled = residual / problem.noise[layout.channel]
    rows = len(residual) / correlation_length(scaled, series)
    numbers = len(calibration.amounts) - float(np.trace(calibration.covariance))
    return float(np.sqrt(rows / max(rows - numbers, 0.3 * rows)))
