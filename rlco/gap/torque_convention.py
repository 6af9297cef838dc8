"""Whether torques were logged as the model means them: sign, unit, and with gravity."""

from __future__ import annotations

import numpy as np

from rlco.errors import DataError
from rlco.gap.log import Array
from rlco.gap.problem import Hypothesis
from rlco.gap.torque_log import TorqueLog

_SURE = 0.8  # correlation from which a convention is judged
_TIMES = 3.0  # a factor that no missing effect explains


def check_convention(problem: TorqueLog) -> None:
    """Compare measured torques with the model's before any effect is fitted.

    A joint is judged where the two go together, with either sign; one that friction
    hides is left alone.

    Raises:
        DataError: If torques run against the model's, are in another unit, or leave
            gravity out.
    """
    traces = [
        problem.traces(Hypothesis(), i) for i in range(len(problem.log.recordings))
    ]
    measured, computed, gravity = (
        np.concatenate([trace[key] for trace in traces])
        for key in ("measured", "simulated", "torque")
    )
    without = computed - gravity
    near = _size(measured - without) < 0.5 * _size(measured - computed)
    if near and _size(measured) * _TIMES > _size(without):
        raise DataError(
            "the measured torques are those of the model without gravity; give the "
            'whole torques of the joints, or a model with gravcomp="1".'
        )
    for column, name in enumerate(problem.log.joints):
        one, other = measured[:, column], computed[:, column]
        if one.std() < 3.0 * problem.noise[column] or other.std() == 0.0:
            continue
        together = float(np.corrcoef(one, other)[0, 1])
        if abs(together) < _SURE:
            continue
        factor = float(one.std() / other.std())
        if together < 0:
            raise DataError(
                f"the torques of joint {name!r} run against the model's (correlation "
                f"{together:.2f}); change the sign of that column."
            )
        if not 1.0 / _TIMES < factor < _TIMES:
            raise DataError(
                f"the torques of joint {name!r} are {factor:.3g} times the model's; "
                "give them in N m at the joint, behind its gear."
            )


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
