"""Which motions to propose: one, or two, that tell rivals apart; or that none does.

A motion is ranked by the logarithm of the Bayes factor that it is expected to give, if
the named effect is the true one: half the sum of squares, in noise floors, of the
difference that remains when the rival's parameters may follow (Laplace's
approximation; Kass and Raftery, JASA 1995).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from zlib import crc32

from rlco.gap.compare.problem import Candidate
from rlco.gap.compare.wording import title
from rlco.gap.diagnose.command_file import write_commands
from rlco.gap.diagnose.motions import SECONDS
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import SURE

# Logarithm of the Bayes factor from which a search tells two explanations apart: its
# likelihood ratio, with a mean of |d|^2 and a deviation of 2 |d|, is then `SURE`
# deviations beyond zero.
ENOUGH = 0.5 * (2.0 * SURE) ** 2
_PLENTY = 3.0  # difference in noise floors beyond which more is no better
_LONGEST = 200  # bytes of a folder's name
#: The name of an entry that says that there is none, and its words.
NO_MOTION = "no_motion"
NONE_TELLS = "No motion of these joints tells them apart."


@dataclass(frozen=True)
class Motion:
    """A motion to record.

    Attributes:
        name: Its name, also that of its folder.
        how: Instruction in one sentence.
        tells_apart: The rivals.
        separation: Smallest difference between two rivals on it, root mean square in
            noise floors; None where it was not simulated.
        log_bayes: Logarithm of the Bayes factor that it is expected to give against
            the rival that it tells apart least; None where it was not simulated.
        commands: Goals of the actuators, one row per frame, (T, actuators) [rad or m];
            None where there is nothing to replay.
        names: Names of the actuators.
        fps: Rate of the goals [Hz].
    """

    name: str
    how: str
    tells_apart: tuple[Candidate, ...]
    separation: float | None = None
    commands: Array | None = None
    names: tuple[str, ...] = ()
    fps: int = 0
    log_bayes: float | None = None

    def save(self, out: str | Path) -> dict[str, object]:
        """Write the commands below ``out/record_next``; return a row for reports."""
        folder = Path("record_next") / _folder_name(self.name)
        if self.commands is not None:
            write_commands(
                Path(out) / folder,
                self.commands,
                names=self.names,
                fps=self.fps,
                task=self.how,
            )
        return {
            "motion": self.name,
            "how": self.how,
            "tells_apart": ", ".join(title(one) for one in self.tells_apart),
            "noise_floors": None
            if self.separation is None
            else round(self.separation, 1),
            "log_bayes_factor": None
            if self.log_bayes is None
            else float(f"{self.log_bayes:.3g}"),
            "seconds": SECONDS if self.commands is not None else None,
            "commands": str(folder) if self.commands is not None else None,
        }


def _folder_name(name: str) -> str:
    """Return a folder's name for a motion: a joint's name in it may be a path."""
    plain = re.sub(r"[/\\\0]", "_", name)
    plain = plain.encode()[:_LONGEST].decode("utf-8", "ignore")
    # Two names that are written alike have folders of their own.
    return plain if plain == name else f"{plain}_{crc32(name.encode()):08x}"


@dataclass(frozen=True)
class Trial:
    """A motion that was simulated under all rivals.

    Attributes:
        motion: The motion.
        differences: How far each rival is from the named effect on it, root mean square
            in noise floors.
        rows: Number of values that are compared.
    """

    motion: Motion
    differences: Mapping[Candidate, float]
    rows: int

    def log_bayes(self, rival: Candidate) -> float:
        """Return the expected logarithm of the Bayes factor against a rival.

        Example:
            >>> lag = Candidate("actuator_lag", "elbow")
            >>> Trial(Motion("chirp", "", ()), {lag: 0.5}, rows=2000).log_bayes(lag)
            250.0
        """
        return 0.5 * self.rows * self.differences[rival] ** 2

    def as_motion(self, named: Candidate, rivals: Sequence[Candidate]) -> Motion:
        """Return the motion as one that tells these rivals from the named effect."""
        return replace(
            self.motion,
            tells_apart=(named, *rivals),
            separation=min(self.differences[rival] for rival in rivals),
            log_bayes=min(map(self.log_bayes, rivals)),
        )


def proposed(
    named: Candidate,
    rivals: Sequence[Candidate],
    trials: Sequence[Trial],
    by_hand: str | None = None,
) -> list[Motion]:
    """Return one motion, or two, that tell rivals apart; and which rivals none does.

    Args:
        named: The effect that is taken as true.
        rivals: Its rivals.
        trials: Motions, simulated under all of them.
        by_hand: What to record where no motion of the arm helps, a sentence.
    """
    best = max(trials, key=lambda one: _rating(one, rivals))
    chosen = [best]
    separated = _separated(chosen, rivals)
    if len(separated) < len(rivals):
        # Two recordings are independent, so that what they say adds up.
        pair = max(combinations(trials, 2), key=lambda two: _reach(two, rivals))
        if len(_separated(pair, rivals)) > len(separated):
            chosen, separated = list(pair), _separated(pair, rivals)
    motions = []
    for trial in chosen:
        others = [other for other in chosen if other is not trial]
        # Each is for what it tells better than the other one.
        mine = [
            rival
            for rival in separated
            if all(trial.log_bayes(rival) >= one.log_bayes(rival) for one in others)
        ]
        if mine:
            motions.append(trial.as_motion(named, mine))
    silent = [rival for rival in rivals if rival not in separated]
    if silent:
        how = " ".join(filter(None, [NONE_TELLS, by_hand]))
        nothing = best.as_motion(named, silent)
        motions.append(
            replace(nothing, name=f"{NO_MOTION}_{named.name}", how=how, commands=None)
        )
    return motions


def _separated(trials: Sequence[Trial], rivals: Sequence[Candidate]) -> list[Candidate]:
    """Return the rivals that some motions together tell apart."""
    return [
        rival
        for rival in rivals
        if sum(trial.log_bayes(rival) for trial in trials) >= ENOUGH
    ]


def _reach(trials: Sequence[Trial], rivals: Sequence[Candidate]) -> tuple[int, float]:
    """Rate motions by how many rivals they tell apart, then by the least of these."""
    separated = _separated(trials, rivals)
    sums = [sum(trial.log_bayes(rival) for trial in trials) for rival in separated]
    return len(separated), min(sums, default=0.0)


def _rating(trial: Trial, rivals: Sequence[Candidate]) -> tuple[int, float, float]:
    """Rate a motion; of those that clearly separate rivals, few joints are better."""
    separated, least = _reach([trial], rivals)
    apart = min(trial.differences[rival] for rival in rivals)
    few = not trial.motion.name.endswith("_all")
    return separated, min(apart, _PLENTY) + (few and apart > _PLENTY), least
