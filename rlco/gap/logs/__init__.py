"""Measured logs of many formats, read and checked."""

from __future__ import annotations

from rlco.gap.logs.read import read_log as read_log
