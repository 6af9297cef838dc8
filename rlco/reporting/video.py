"""Writing films."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_video(path: Path, frames: NDArray[np.uint8], rate: float) -> None:
    """Write images as an mp4 video (H.264).

    Args:
        path: The video.
        frames: Images, (T, height, width, 3). An odd height or width gets one more
            row or column, a copy of the last: H.264 keeps a colour for four pixels.
        rate: Frames per second [Hz].

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder, "grey.mp4")
        ...     write_video(path, np.full((2, 16, 16, 3), 128, np.uint8), 20.0)
        ...     path.exists()
        True
    """
    import imageio.v3 as imageio

    _, height, width, _ = frames.shape
    even = [(0, 0), (0, height % 2), (0, width % 2), (0, 0)]
    film = np.pad(frames, even, mode="edge")
    # PyAV encodes in this process: where that is large, the system may refuse to fork
    # it for ffmpeg.
    imageio.imwrite(path, film, fps=rate, codec="libx264", plugin="pyav")
