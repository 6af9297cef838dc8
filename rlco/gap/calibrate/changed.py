"""A later recording of a robot whose model was calibrated: what changed since."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis, Problem, Run
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Array

# Friction of a measured motion is that of a smoothed one, and unknown at rest.
INEXACT = 0.02
STANDING = 0.2  # weight of a joint at rest beside one in motion


class Changed(Problem):
    """A `Problem`: a calibrated model against a recording made later.

    Args:
        base: The model with what is known of it, and the later recording.
        correction: What the model lacked before, at each row as weighted, (N,).
        noise: Standard deviation of what is not known of each channel, (channels,).
        weight: How much each row counts, (N,); None for all alike.
    """

    def __init__(
        self,
        base: Problem,
        correction: Array,
        noise: Array,
        weight: Array | None = None,
    ) -> None:
        self.base, self.correction, self.noise = base, correction, noise
        self.weight = np.ones(len(correction)) if weight is None else weight
        self.has_outliers = base.has_outliers
        self.model, self.log, self.layout = base.model, base.log, base.layout
        self.tolerance_names = base.tolerance_names
        self.calibration = base.calibration
        self.noise_was_observed = base.calibration is not None
        self.inexact = INEXACT if isinstance(base, TorqueLog) else 0.0

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that may have changed."""
        return self.base.candidates()

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return initial values of first parameters that the log suggests."""
        return self.base.usual_sizes()

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return what changed and no hypothesis explains, (hypotheses, N)."""
        rows = self.base.residuals(hypotheses, recordings)
        if recordings is None:
            return rows * self.weight - self.correction
        some = np.isin(self.layout.recording, recordings)
        return rows * self.weight[some] - self.correction[some]

    def by_guesses(self, hypothesis: Hypothesis) -> Array:
        """Return changes of the residuals by guessed commands, (K, N)."""
        return np.asarray(self.base.by_guesses(hypothesis) * self.weight)

    def weighted_base(self) -> tuple[Problem, Array]:
        """Return the comparison with the later recording, and its rows' weights."""
        return self.base, self.weight

    def runs(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> Sequence[Run]:
        """Return the rollouts of some recordings, see `Problem.runs`."""
        return self.base.runs(hypothesis, recordings)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return the signals of one recording, with what the model lacked before."""
        traces = dict(self.base.traces(hypothesis, recording))
        near = self.layout.recording == recording
        channels = len(self.layout.channels)
        time = self.layout.time[near][::channels]
        rows = np.searchsorted(traces["time"], time - 1e-9)
        simulated = np.array(traces["simulated"], dtype=float)
        lacking = self.correction[near] / self.weight[near]
        simulated[rows] += lacking.reshape(-1, channels)
        return {**traces, "simulated": simulated}


def weights_of(problem: Problem) -> Array:
    """Return how much each row of a residual counts, (N,).

    Where a joint stands, its friction is known by no motion: what was added there since
    would look like another effect.
    """
    if isinstance(problem, TorqueLog):
        return np.where(problem.standing(), STANDING, 1.0)
    return np.ones(len(problem.layout.channel))
