"""Measured logs against a simulated robot: where they differ, what is missing.

`run_gap` is the whole workflow. Its parts: `load_model` and `read_log` read what a user
has, `make_problem` decides how the two are compared, `find_gap` says what is missing.
"""

from rlco.gap.check import check_effects
from rlco.gap.logs import read_log
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model
from rlco.gap.search.find_gap import find_gap
from rlco.gap.workflow import Finding, run_gap

__all__ = [
    "Finding",
    "check_effects",
    "find_gap",
    "load_model",
    "make_problem",
    "read_log",
    "run_gap",
]
