"""Writing films."""

from __future__ import annotations

import io
from fractions import Fraction
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


def mp4(frames: NDArray[np.uint8], rate: int, *, quality: int = 23) -> bytes:
    """Return images as an mp4 film (H.264) for a page: the same bytes each time.

    Args:
        frames: Images of even height and width, (T, height, width, 3).
        rate: Frames per second [Hz].
        quality: H.264's constant rate factor, from 0; 6 more halve the size.

    Example:
        >>> grey = np.full((3, 16, 16, 3), 128, np.uint8)
        >>> mp4(grey, 25)[4:8]
        b'ftyp'
    """
    import av

    _, height, width, _ = frames.shape
    out = io.BytesIO()
    with av.open(out, "w", format="mp4") as film:
        stream = film.add_stream("libx264", rate=Fraction(rate))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        # In one thread, so that the bytes do not depend on the machine's cores.
        stream.options = {"crf": str(quality), "threads": "1"}
        for image in frames:
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")):
                film.mux(packet)
        for packet in stream.encode():
            film.mux(packet)
    return out.getvalue()
