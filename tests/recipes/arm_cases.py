"""Data sets whose actions, robots and rates tests choose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rlco.data import DemoWriter


def write_arm(
    path: Path,
    *,
    joints: int = 6,
    scale: float = 1.0,
    episodes: int = 2,
    frames: int = 12,
    fps: int = 30,
    texts: tuple[str, ...] = ("sort the screws",),
    poses: bool = True,
    camera: str | None = None,
) -> Path:
    """Write episodes of an arm commanded by joint angles up to ``scale``.

    ``poses`` says where a screw is, ``camera`` shows noise.
    """
    names = [f"joint{i}" for i in range(joints)]
    rng = np.random.default_rng(1)
    with DemoWriter(
        path,
        fps=fps,
        state_names=names,
        environment_state_names=["screw.x"] if poses else None,
        action_names=names,
        camera=camera,
        image_size=None if camera is None else (64, 64),
    ) as writer:
        for episode in range(episodes):
            for frame in range(frames):
                angles = scale * np.sin(frame / 4 + np.arange(joints) + episode)
                screw = rng.normal(size=1).astype(np.float32)
                image = None
                if camera is not None:
                    image = rng.integers(256, size=(3, 64, 64), dtype=np.uint8)
                writer.add_frame(
                    state=angles.astype(np.float32),
                    environment_state=screw if poses else None,
                    image=image,
                    action=angles.astype(np.float32),
                    task=texts[episode % len(texts)],
                )
            writer.save_episode()
    return path
