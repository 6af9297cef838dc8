"""The regular clock behind a recording's stamps, with rows that are missing.

Many loggers read a robot at the ticks of a clock and stamp the row when they get to it,
some milliseconds later or earlier, and lose a row now and then. The clock is found from
the stamps alone: its period as the peak of their periodogram, the tick of each row as
the most likely path (Viterbi 1967) under Gaussian stamps and rare losses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rlco.gap.logs.log import Array

_FEWEST = 30  # rows; a clock of fewer is no finding
_FIRST = 4000  # rows that the period is first taken from
_COHERENT = 0.3  # length of the mean phase; that of stamps off by a quarter of a period
_SPREAD = 0.28  # deviation of stamps, in periods, that any times look to have
_OTHER = 5.0  # standard errors between periods of loggers at different rates
# Standard errors within which a rate may be a whole number. Nine loggers in ten run at
# one and others anywhere within a per cent: with ten logs of six seconds, whose stamps
# are off by a fifth of a period, these are as likely 3.85 errors away, and the errors
# are a sixth larger than a line's, as some rows are taken for the tick beside theirs.
_MOST = 4.5
_WHOLE = 0.25  # ... if they are no more than this [1/s]
_LOSS = 3.5  # cost of a row missing: the negative logarithm of three per cent
_MOST_RATES = 1_000_000  # tried at most; an hour of rows at 1 kHz takes twelve thousand


class Clock(NamedTuple):
    """A regular clock, and the rows on it.

    Attributes:
        ticks: Tick of each row, rising, (T,).
        period: Of the clock [s].
        start: Time of tick zero on the stamps' clock [s].
        jitter: Standard deviation of the stamps about the ticks [s].
    """

    ticks: Array
    period: float
    start: float
    jitter: float

    @property
    def doubt(self) -> float:
        """Standard error of the period [s], of a line fitted to the stamps."""
        ticks = self.ticks - self.ticks.mean()
        return self.jitter / float(np.sqrt((ticks**2).sum()))

    @property
    def time(self) -> Array:
        """Time of each row's tick on the stamps' clock, (T,) [s]."""
        return np.asarray(self.start + self.period * self.ticks)


def clock_of(stamps: Array) -> Clock | None:
    """Return the regular clock that a recording's stamps scatter about; None for none.

    Args:
        stamps: In the order of the rows; a few may run backwards, (T,) [s].

    Example:
        >>> random = np.random.default_rng(0)
        >>> ticks = np.delete(np.arange(500.0), [100, 300, 301])
        >>> stamps = 3.0 + 0.02 * (ticks + random.normal(0.0, 0.15, 497))
        >>> clock = clock_of(stamps)
        >>> round(clock.period, 4), round(clock.jitter / clock.period, 2)
        (0.02, 0.15)
        >>> bool((clock.ticks == ticks).all())
        True
    """
    steps = np.diff(stamps)
    if len(stamps) < _FEWEST or not np.median(steps) > 0:
        return None
    rows = min(len(stamps), _FIRST)
    fit, again = _loudest(stamps[:rows]), 3
    while fit is not None:
        for _ in range(again):
            ticks = _most_likely_ticks((stamps[:rows] - fit[0]) / fit[1])
            slope, start = np.polyfit(ticks, stamps[:rows], 1)
            fit = float(start), float(slope)
        if rows == len(stamps):
            break
        rows, again = min(len(stamps), 4 * rows), 1
    # A stamp of another time may have no tick between those beside it.
    if fit is None or not (np.diff(ticks) >= 1.0).all():
        return None
    start, period = fit
    jitter = float(np.std(stamps - start - period * ticks))
    if jitter > _SPREAD * period:
        return None
    first = float(ticks[0])
    return Clock(ticks - first, period, start + period * first, jitter)


def in_step(clocks: Sequence[Clock]) -> list[Clock]:
    """Return the clocks of one logger's recordings with the period that they share.

    Recordings of a few seconds leave a period open by a ten-thousandth, which is half a
    millisecond at their end. A rate that may be a whole number [1/s] is one.

    Example:
        >>> ticks = np.arange(300.0)
        >>> of = [Clock(ticks, p, 0.0, 0.003) for p in (0.020004, 0.019998)]
        >>> [round(clock.period, 9) for clock in in_step(of)]
        [0.02, 0.02]
    """
    weight = np.array([clock.doubt**-2 for clock in clocks])
    periods = np.array([clock.period for clock in clocks])
    period = float((weight * periods).sum() / weight.sum())
    if (np.abs(periods - period) * np.sqrt(weight)).max() > _OTHER:
        return list(clocks)
    rate, doubt = 1.0 / period, _MOST / (period**2 * math.sqrt(weight.sum()))
    if abs(rate - round(rate)) < doubt < _WHOLE:
        period = 1.0 / round(rate)
    found = []
    for clock in clocks:
        change = (clock.period - period) * float(clock.ticks.mean())
        found.append(clock._replace(period=period, start=clock.start + change))
    return found


def _loudest(stamps: Array) -> tuple[float, float] | None:
    """Return start and period [s] of the clock whose phase the stamps share best."""
    usual = float(np.median(np.diff(stamps)))
    # Rates whose phases differ by a quarter of a turn at the end.
    apart = 1.0 / (4.0 * float(np.ptp(stamps)))
    count = math.ceil(1.5 / math.sqrt(len(stamps)) / usual / apart)
    if count > _MOST_RATES:  # a stamp of another age: no clock says that
        return None
    coarse, _ = _peak(stamps, 1.0 / usual + apart * _around(count))
    rate, phase = _peak(stamps, coarse + apart * _around(16) / 16.0)
    if abs(phase) < _COHERENT:
        return None
    turn = float(np.angle(phase)) / (2.0 * np.pi)
    return float(stamps[0]) + turn / rate, 1.0 / rate


def _around(count: int) -> Array:
    return np.arange(-count, count + 1, dtype=float)


def _peak(stamps: Array, rates: Array) -> tuple[float, complex]:
    """Return the rate [1/s] at which stamps share their phase best, and its mean."""
    since = stamps - stamps[0]
    # A few rates at a time: all of them at once would fill the memory.
    phases = np.concatenate(
        [
            np.exp(2j * np.pi * np.outer(part, since)).mean(axis=1)
            for part in np.array_split(rates, max(1, len(rates) // 64))
        ]
    )
    best = int(np.abs(phases).argmax())
    return float(rates[best]), complex(phases[best])


def _most_likely_ticks(place: Array) -> Array:
    """Return the tick of each row, rising, from its stamp in periods, (T,)."""
    near = np.round(place)
    off = place - near
    spread = max(0.05, float(np.std(off)))
    if (np.diff(near) >= 1).all() and np.abs(off).max() < 0.2:
        return near
    # Each row's tick is the nearest, or the one before or after it.
    choices = (-1.0, 0.0, 1.0)
    likely = [[(o - c) ** 2 / (2.0 * spread**2) for c in choices] for o in off.tolist()]
    cost, came = likely[0], list[list[int]]()
    for (a, b), here in zip(pairwise(near.tolist()), likely[1:], strict=True):
        new, source = [], []
        for choice, own in zip(choices, here, strict=True):
            arrivals = [
                before + _step_cost(b + choice - a - earlier)
                for before, earlier in zip(cost, choices, strict=True)
            ]
            least = min(range(3), key=arrivals.__getitem__)
            new.append(arrivals[least] + own)
            source.append(least)
        cost = new
        came.append(source)
    at = min(range(3), key=cost.__getitem__)
    path = [at]
    for source in reversed(came):
        at = source[at]
        path.append(at)
    return np.asarray(near + np.array(choices)[path[::-1]])


def _step_cost(ticks: float) -> float:
    if ticks < 1.0:
        return math.inf
    return 0.0 if ticks == 1.0 else _LOSS
