"""What Stage I and Stage II train: options, data, learner, and their loops.

The modules of options import no torch, so that a recipe's help and its complaints about
wrong options come at once; what is named here is therefore imported when it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rlco.training.learner import Learner as Learner
    from rlco.training.master_weights import MasterWeightAdamW as MasterWeightAdamW

_MODULES = {
    "Learner": "rlco.training.learner",
    "MasterWeightAdamW": "rlco.training.master_weights",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)
