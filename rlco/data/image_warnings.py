"""What is said of demonstrations' images before anything is trained on them."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

from rlco.data.demos import DemoReplayBuffer
from rlco.lerobot_files import read_folder

_log = logging.getLogger("rlco.data")


def say_drawn_otherwise(
    demos: Iterable[DemoReplayBuffer | None], renderer: str
) -> None:
    """Say so where a simulator's images were drawn by another renderer.

    Args:
        demos: Demonstrations; None where there are none.
        renderer: What draws the images that the policy reads.
    """
    for one in demos:
        drawn = None if one is None else one.meta.recorded.get("renderer")
        if one is not None and drawn not in (None, renderer):
            _log.warning(
                "%s was drawn by renderer=%s, but the policy's images are drawn by %s; "
                "record it again, or give renderer=%s",
                one.meta.path,
                drawn,
                renderer,
                drawn,
            )


def say_blind(demos: Iterable[DemoReplayBuffer], state_names: Sequence[str]) -> None:
    """Say so where data have images, and a policy reads the robot's state alone.

    Args:
        demos: Demonstrations.
        state_names: What the state consists of.
    """
    for one in demos:
        cameras = [
            name.rpartition(".")[2] for name in read_folder(one.meta.path).cameras
        ]
        if not cameras:
            continue
        which = f" real_camera={cameras[0]}" if len(cameras) > 1 else ""
        _log.warning(
            "%s has images (%s), and nothing of them is read: a policy that reads the "
            "robot's state alone (%s) cannot see objects, and repeats a mean motion "
            "where they matter; give image=conv%s to read images",
            one.meta.path,
            ", ".join(cameras),
            ", ".join(state_names),
            which,
        )
