"""Options of a policy that reads from which domain a row is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlco.errors import ConfigError
from rlco.runs.config import RunOptions, option

if TYPE_CHECKING:
    from rlco.policies import ChunkPolicy


def flag_probability(value: float | None) -> str | None:
    """Say why a flag cannot be dropped with a probability; None where it can.

    Example:
        >>> flag_probability(0.1)
        >>> flag_probability(0.0)
        '0.0 is to lie between 0 and 1, such as 0.1: guidance needs rows of both kinds'
    """
    if value is None or 0 < value < 1:
        return None
    return (
        f"{value} is to lie between 0 and 1, such as 0.1: guidance needs rows of both "
        "kinds"
    )


@dataclass
class DomainFlagOptions(RunOptions):
    """Whether a policy reads from which domain a row is, and how that guides it."""

    domain_flag: float | None = option(
        None,
        "probability of dropping the flag, sim or real, that the policy reads beside "
        "each row, such as 0.1; null: no flag",
        check=flag_probability,
    )
    guidance: float = option(
        1.0,
        "domain_flag: weight of the robot's flag as the policy acts; 1: the flag alone",
    )


def check_domain_flag(options: DomainFlagOptions, sim_ratio: float) -> None:
    """Check what the options of the flag say of each other and of the share of sim.

    Raises:
        ConfigError: They contradict each other; every problem is reported.
    """
    problems = []
    if options.domain_flag is None and options.guidance != 1.0:
        problems.append(
            f"guidance={options.guidance} needs a flag to be guided by; give "
            "domain_flag=0.1 with it"
        )
    if options.domain_flag is not None and sim_ratio in (0, 1):
        problems.append(
            f"domain_flag={options.domain_flag} distinguishes two domains, but "
            f"sim_ratio={sim_ratio:g} leaves one; give a ratio between 0 and 1, or "
            "leave domain_flag out"
        )
    if problems:
        raise ConfigError(problems)


def refuse_domain_flag(policy: ChunkPolicy, folder: str) -> None:
    """Check that a policy of Stage II reads no domain flag.

    Raises:
        ConfigError: It reads one.
    """
    if policy.guidance is not None:
        raise ConfigError(
            [
                f"policy={folder} reads a domain flag (sft domain_flag=), and acts "
                "under the robot's, under which RL would then teach it the simulator; "
                "give a policy that was trained without domain_flag"
            ]
        )
