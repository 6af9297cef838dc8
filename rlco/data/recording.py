"""Recording demonstrations as a LeRobot v3 data set, through the lerobot library.

lerobot is imported when a writer is made, not before: its import takes ten seconds.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from rlco.data.low_dim_episodes import LowDimEpisodes
from rlco.errors import ConfigError, DataError, OutputExistsError
from rlco.lerobot_files import RECORDED, UNFINISHED_MARK
from rlco.runs.whole_files import sync_tree

Frame = dict[str, Any]


class DemoWriter:
    """Writes episodes to a new LeRobot v3 data set.

    A context manager. Until it is closed without an error the folder holds a mark
    by which ``load_demos`` knows the recording as unfinished, whatever ended it;
    the episodes saved until an error stay on disk. Where there are none, the folder is
    removed.

    Args:
        path: The new folder.
        fps: Frames a second [1/s].
        state_names: One name a number of ``observation.state``.
        action_names: One name a number of ``action``.
        environment_state_names: One name a number of
            ``observation.environment_state``; None leaves it out.
        robot_type: A word for the robot.
        camera: Name of one camera, kept as ``observation.images.<camera>``, or a list
            of several names.
        image_size: Height and width of their images [pixels].
        video: Keep the images as video (small, lossy) and not as PNG (exact).
        recorded: How it is recorded, in types of JSON, kept as ``meta/rlco.json``.

    Raises:
        OutputExistsError: The folder exists; nothing in it was touched.
        ConfigError: Names that are missing or twice there, or a camera without size.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        fps: int,
        state_names: Sequence[str],
        action_names: Sequence[str],
        environment_state_names: Sequence[str] | None = None,
        robot_type: str | None = None,
        camera: str | Sequence[str] | None = None,
        image_size: tuple[int, int] | None = None,
        video: bool = False,
        recorded: Mapping[str, Any] | None = None,
    ) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise OutputExistsError(path)
        self._numeric = {
            "observation.state": tuple(state_names),
            "action": tuple(action_names),
        }
        if environment_state_names is not None:
            names = tuple(environment_state_names)
            self._numeric["observation.environment_state"] = names
        self._image_size = image_size
        self._one_camera = isinstance(camera, str)
        names = (camera,) if isinstance(camera, str) else tuple(camera or ())
        self._cameras = {name: f"observation.images.{name}" for name in names}
        problems = _problems(fps, self._numeric, names, image_size)
        if problems:
            raise ConfigError(problems)
        self._dataset = self._create(fps, robot_type, video)
        (self.path / UNFINISHED_MARK).touch()
        if recorded is not None:
            (self.path / RECORDED).write_text(json.dumps(dict(recorded), indent=2))
        # Images go through lerobot's own frame buffer, numbers through a quicker way.
        self._episodes = None if names else LowDimEpisodes(self._dataset.meta)
        self._pending: list[Frame] = []
        self._open = True

    @property
    def pending_frames(self) -> int:
        """Frames added since the last saved or discarded episode."""
        return len(self._pending)

    @property
    def saved_episodes(self) -> int:
        """Episodes saved so far."""
        return int(self._dataset.meta.total_episodes)

    def add_frame(
        self,
        *,
        state: npt.ArrayLike,
        action: npt.ArrayLike,
        task: str,
        environment_state: npt.ArrayLike | None = None,
        image: npt.ArrayLike | Mapping[str, npt.ArrayLike] | None = None,
    ) -> None:
        """Add a frame to the episode under way.

        Args:
            state: Shape (S,), in the units that its names give.
            action: Shape (A,), taken in that state.
            task: The instruction.
            environment_state: Shape (E,), where it is recorded.
            image: uint8, shape (3, height, width), where there is a camera; a map by
                name to such where a list of cameras was given.

        Raises:
            DataError: A value is missing, not wanted, of another size, or not finite.
        """
        given = {
            "observation.state": state,
            "action": action,
            "observation.environment_state": environment_state,
        }
        frame: Frame = {"task": task}
        if not task.strip():
            raise DataError("a frame's task is an empty text; give the instruction.")
        for name, value in given.items():
            if (value is None) != (name not in self._numeric):
                raise DataError(
                    f"{name} is {'not given' if value is None else 'given'}, but "
                    f"the data set records {', '.join(self._numeric)}."
                )
            if value is not None:
                frame[name] = self._numbers(name, value)
        frame |= self._images(image)
        self._pending.append(frame)

    def save_episode(self) -> None:
        """Write the frames added so far as one episode.

        Raises:
            DataError: There are none.
        """
        if not self._pending:
            raise DataError("an episode without frames cannot be saved.")
        frames, self._pending = self._pending, []
        if self._episodes is not None:
            self._episodes.save(frames)
            return
        import datasets

        # lerobot draws a progress bar for each episode.
        bars_were_off = datasets.are_progress_bars_disabled()
        datasets.disable_progress_bars()
        for frame in frames:
            self._dataset.add_frame(frame)
        self._dataset.save_episode()
        if not bars_were_off:
            datasets.enable_progress_bars()

    def discard_episode(self) -> None:
        """Forget the frames added since the last saved episode."""
        self._pending = []

    def close(self) -> None:
        """Finish the data set: from now on it can be read.

        Raises:
            DataError: Frames were added but neither saved nor discarded, or nothing
                was recorded; the data set then stays unfinished.
        """
        if not self._open:
            return
        self._finalize()
        if self._pending:
            raise DataError(
                f"{len(self._pending)} frames were added to {str(self.path)!r} after "
                "the last episode; call save_episode() or discard_episode() before "
                "closing."
            )
        if not self.saved_episodes:
            raise DataError(f"nothing was recorded to {str(self.path)!r}.")
        _order_statistics(self.path / "meta" / "stats.json")
        sync_tree(self.path)  # else a power cut leaves empty files that nothing marks
        (self.path / UNFINISHED_MARK).unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error_type is None:
            self.close()
        else:
            self._finalize()
            if not self.saved_episodes:  # nothing to keep, and in the next one's way
                shutil.rmtree(self.path)

    def _create(self, fps: int, robot_type: str | None, video: bool) -> Any:
        from lerobot.datasets import LeRobotDataset

        features: dict[str, Any] = {
            name: {"dtype": "float32", "shape": (len(names),), "names": list(names)}
            for name, names in self._numeric.items()
        }
        for feature in self._cameras.values():
            features[feature] = {
                "dtype": "video" if video else "image",
                "shape": (*(self._image_size or ()), 3),
                "names": ["height", "width", "channels"],
            }
        return LeRobotDataset.create(
            repo_id=f"local/{self.path.name}",
            root=self.path,
            fps=fps,
            features=features,
            robot_type=robot_type,
            use_videos=video,
            # Its default tries torchcodec, with a page of warnings where that fails.
            video_backend="pyav",
        )

    def _finalize(self) -> None:
        self._open = False
        if self._episodes is not None:
            self._episodes.close()
        self._dataset.finalize()

    def _numbers(self, name: str, value: npt.ArrayLike) -> npt.NDArray[np.float32]:
        array = np.array(value, np.float32)
        if array.shape != (len(self._numeric[name]),):
            raise DataError(
                f"{name} has shape {array.shape}, but {len(self._numeric[name])} names."
            )
        if not np.isfinite(array).all():
            raise DataError(
                f"{name} of frame {len(self._pending)} of episode "
                f"{self.saved_episodes} is NaN or infinite: {array.tolist()}."
            )
        return array

    def _images(self, image: Any) -> Frame:
        """Return the images of one frame by their features."""
        if (image is None) != (not self._cameras):
            raise DataError(
                f"image is {'not given' if image is None else 'given'}, but the data "
                f"set records {', '.join(self._cameras.values()) or 'no camera'}."
            )
        if image is None:
            return {}
        by_name = image
        if self._one_camera:
            by_name = dict.fromkeys(self._cameras, image)
        elif not isinstance(image, Mapping) or set(image) != set(self._cameras):
            raise DataError(
                "image must be a map with an image of each of the cameras "
                f"{', '.join(self._cameras)}."
            )
        return {
            feature: self._image(by_name[name])
            for name, feature in self._cameras.items()
        }

    def _image(self, image: npt.ArrayLike) -> npt.NDArray[np.uint8]:
        array = np.asarray(image)
        wanted = (3, *(self._image_size or ()))
        if array.dtype != np.uint8 or array.shape != wanted:
            raise DataError(
                f"image is {array.dtype} of shape {array.shape}, but must be uint8 of "
                f"shape {wanted}."
            )
        return np.ascontiguousarray(array.transpose(1, 2, 0))


def _problems(
    fps: int,
    numeric: Mapping[str, Sequence[str]],
    cameras: Sequence[str],
    image_size: tuple[int, int] | None,
) -> list[str]:
    problems = [
        f"the names of {name} must be at least one and all different, not {names}"
        for name, names in numeric.items()
        if not names or len(set(names)) < len(names)
    ]
    if fps < 1 or int(fps) != fps:
        problems.append(f"fps={fps}, but LeRobot wants a whole number of at least 1")
    if len(set(cameras)) < len(cameras):
        problems.append(f"the cameras {list(cameras)} must all be different")
    if (not cameras) != (image_size is None):
        problems.append("camera and image_size belong together; give both or neither")
    return problems


def _order_statistics(path: Path) -> None:
    """Sort the features of statistics: LeRobot writes them in the order of a set.

    That differs from process to process. The same recording is to be the same bytes,
    by which a run that is resumed knows its demonstrations.
    """
    from lerobot.utils.io_utils import load_json, write_json

    write_json(dict(sorted(load_json(path).items())), path)
