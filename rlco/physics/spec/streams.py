"""Random streams of an episode, each of its own: none shifts what another draws."""

from __future__ import annotations

from enum import IntEnum, unique


@unique
class Stream(IntEnum):
    """What ``default_rng([seed, episode, stream])`` draws.

    How the episode starts is drawn by ``default_rng([seed, episode])``, and how late
    its commands arrive by a child of that.

    Attributes:
        NOISE: Errors of its sensors.
        LOOK: Its look, where each episode has another one.
        PIXELS: Noise of its images.
        PARAMETER_SET: Which of a domain's parameter sets it has.
    """

    NOISE = 1
    LOOK = 2
    PIXELS = 3
    PARAMETER_SET = 4
