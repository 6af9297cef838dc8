"""Options that say which simulator Stage II trains in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rlco.runs.config import RunOptions, option


@dataclass
class TrainingDomainOptions(RunOptions):
    """The domain that a policy trains in, and effects of a user's own."""

    train_domain: str = option(
        "sim",
        "domain to train in: a name, MODULE:NAME, or the path of an effects.yaml",
        input="file",
    )
    train_sample: Literal["none", "posterior"] = option(
        "none",
        "posterior: each training episode draws one of the parameter sets in "
        "train_domain's file",
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own", input="file"
    )
