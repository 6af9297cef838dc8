"""Figures of images: frames of an episode, one state as several cameras show it.

As those of :mod:`rlco.reporting.plots`, they carry their title and how to read them,
and say which simulator rendered them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from rlco.reporting.plot_style import (
    INK,
    SAME_SCENE,
    WIDTH,
    caption,
    domain_label,
    new_figure,
)


def episode_strip(
    frames: Sequence[npt.NDArray[np.uint8]],
    seconds: Sequence[float],
    domain: str,
    *,
    policy: str = "",
    instruction: str = "",
) -> Figure:
    """Draw a few frames of one episode in a row.

    Args:
        frames: Images of equal size. Shape (height, width, 3) each.
        seconds: Time of each frame [s].
        domain: The domain of the episode.
        policy: Name of the policy that acts, for the caption.
        instruction: What it was asked to do, for the caption.
    """
    height, width = frames[0].shape[:2]
    tall = WIDTH / len(frames) * height / width + 0.9
    figure, panels = new_figure("One episode", len(frames), height=tall)
    for axes, frame, second in zip(panels, frames, seconds, strict=True):
        axes.imshow(frame)
        axes.set_axis_off()
        axes.set_title(f"{second:.1f} s", fontsize=10, color=INK)
    task = f', asked to "{instruction}"' if instruction else ""
    who = f"Policy {policy}{task}. " if policy else ""
    caption(figure, f"{who}Rendered in {domain_label(domain)}.")
    return figure


def same_scene(images: Mapping[str, Mapping[str, npt.NDArray[np.uint8]]]) -> Figure:
    """Draw what each camera shows of one state, the domains beside each other.

    Args:
        images: By camera and domain, all of one size. Shape (height, width, 3) each.
    """
    panes = [
        (camera, domain, image)
        for camera, by_domain in images.items()
        for domain, image in by_domain.items()
    ]
    height, width = panes[0][2].shape[:2]
    tall = WIDTH / len(panes) * height / width + 1.1
    figure, panels = new_figure(SAME_SCENE, len(panes), height=tall)
    for axes, (camera, domain, image) in zip(panels, panes, strict=True):
        axes.imshow(image, interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(f"{domain}\n{camera}", fontsize=10, color=INK)
    domains = dict.fromkeys(domain_label(domain) for _, domain, _ in panes)
    caption(
        figure,
        f"Images of {' and '.join(images)} as an episode starts, {width} x {height} "
        f"pixels, as policies read them. Rendered in {' and in '.join(domains)}.",
    )
    return figure
