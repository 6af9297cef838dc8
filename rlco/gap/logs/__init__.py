"""Reading and checking measured logs of many formats."""

from __future__ import annotations

from rlco.gap.logs.read import read_log as read_log
