"""LeRobot folders (v2.1 and v3) read and checked without torch or lerobot.

``read_folder`` reads the metadata, ``read_columns`` the numeric features and
``iterate_images`` the images, PNG or video. Every defect raises ``DataError``.
"""

from __future__ import annotations

from rlco.lerobot_files.columns import LARGEST as LARGEST
from rlco.lerobot_files.columns import check_stored_sizes as check_stored_sizes
from rlco.lerobot_files.columns import read_columns as read_columns
from rlco.lerobot_files.folder import RECORDED as RECORDED
from rlco.lerobot_files.folder import UNFINISHED_MARK as UNFINISHED_MARK
from rlco.lerobot_files.folder import read_folder as read_folder
from rlco.lerobot_files.images import iterate_images as iterate_images
from rlco.lerobot_files.schema import Episode as Episode
from rlco.lerobot_files.schema import Feature as Feature
from rlco.lerobot_files.schema import LeRobotFolder as LeRobotFolder
from rlco.lerobot_files.schema import VideoSpan as VideoSpan
