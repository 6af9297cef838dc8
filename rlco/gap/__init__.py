"""Measured logs against a simulated robot: where they differ, what is missing.

`load_model` and `read_log` read what a user has, `make_problem` decides how the two are
compared, `find_gap` says what is missing.
"""

from rlco.gap.find_gap import find_gap
from rlco.gap.logs import read_log
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model

__all__ = ["find_gap", "load_model", "make_problem", "read_log"]
