"""One page on how much of what sim teaches holds for the robot's demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path

from rlco.reporting.alignment.map import (
    Column,
    in_percent,
    in_words,
    neighbours,
    points,
    read_map,
)
from rlco.reporting.html import page, paragraphs, table
from rlco.runs.whole_files import write_json, write_text

#: What was trained on what and tested on what, by the names of the shares.
ROWS = {
    "own": ("simulated demonstrations", "others of these"),
    "cross": ("simulated demonstrations", "the real ones"),
    "real_only": ("real demonstrations", "others of these"),
    "both": ("both, half and half", "real ones that were held out"),
}
#: Shares closer than this are not called better or worse: other folds move them so.
ALIKE = 0.05


@dataclass(frozen=True)
class Alignment:
    """What `recipes/align.py` measured.

    Attributes:
        shares: Share of the demonstrated actions' variance that is explained, by
            ``own``, ``cross``, ``real_only`` and ``both``.
        by_action: The same of each action number; None where none was moved.
        actions: Names of the action numbers.
        probe: How often a linear probe tells the domains apart; 0.5 is chance.
        sim: Folder of the simulated demonstrations, and how many were trained on.
        real: Folder of the real demonstrations, and how many there are.
        folds: In how many parts the real ones were held out.
    """

    shares: Mapping[str, float]
    by_action: Mapping[str, Sequence[float | None]]
    actions: Sequence[str]
    probe: float
    sim: tuple[str, int]
    real: tuple[str, int]
    folds: int

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        own, cross, alone, both = (self.shares[name] for name in ROWS)
        found = [
            f"What {self.sim[1]} simulated demonstrations teach explains "
            f"{in_percent(own)} of other simulated ones, and {in_percent(cross)} of "
            f"the {self.real[1]} real ones."
        ]
        if cross <= 0:
            found.append(
                "So a policy that has seen the simulator alone does worse where the "
                "robot was shown what to do than one that always does the mean: the "
                "same observations call for other actions."
            )
        elif cross >= own - ALIKE:
            found.append("So what is learned in the simulator holds for the robot.")
        else:
            found.append("So part of what it teaches holds for the robot.")
        found.append(
            f"The real demonstrations alone explain {in_percent(alone)} of held-out "
            f"real ones, together with the simulated ones {in_percent(both)}."
        )
        if both > alone + ALIKE:
            found.append("Simulated demonstrations help imitation here.")
        elif both < alone - ALIKE:
            found.append(
                "Simulated demonstrations harm imitation here: compare with "
                "sim_ratio=0 before anything else."
            )
        else:
            found.append("Simulated demonstrations change imitation little here.")
        found.append(
            f"A linear probe of the policy's features tells the domains apart in "
            f"{in_percent(self.probe)} of held-out frames (50 % is chance)."
        )
        near = neighbours(read_map(), cross)
        found.append(
            "Of the gaps between two simulators that were mapped, "
            f"{'these teach' if len(near) > 1 else 'this one teaches'} about as much:"
        )
        return [*found, *map(in_words, near)]


def write_alignment(folder: Path, found: Alignment) -> Path:
    """Write ``alignment.json`` and ``report.html`` into a folder; return the latter."""
    write_json(folder / "alignment.json", asdict(found))
    title = (
        f"The simulated demonstrations explain {in_percent(found.shares['cross'])} of "
        "what the robot was shown"
    )
    shares = [
        [escape(trained), escape(tested), in_percent(found.shares[name])]
        for name, (trained, tested) in ROWS.items()
    ]
    actions = [
        [escape(name), *(_cell(found.by_action[row][k]) for row in ROWS)]
        for k, name in enumerate(found.actions)
    ]
    body = "\n".join(
        [
            f'<header>\n<p class="kicker">rlco · align</p>\n<h1>{escape(title)}</h1>\n'
            "</header>",
            paragraphs(found.sentences()),
            "<h2>Explained of the demonstrated actions</h2>",
            table(["trained on", "tested on", "explained"], shares),
            paragraphs(
                [
                    "The share of the variance of demonstrated action chunks that the "
                    "policy's most likely actions explain, in units of the normalised "
                    "action: 100 % is what was demonstrated, 0 the demonstrations' "
                    "mean. Noise of the demonstrations cannot be explained. "
                    f"Real episodes are held out in {found.folds} parts, each once."
                ]
            ),
            "<h2>By action number</h2>",
            table(
                ["action", *(f"{a} → {b}" for a, b in ROWS.values())],
                actions,
            ),
            "<h2>What became of such cases</h2>",
            map_table(read_map(), found.shares["cross"]),
            paragraphs(
                [
                    "Each line is a gap between sim and a second simulator in the "
                    "robot's part, means of five seeds; no robot moved. sft imitates "
                    "both kinds of demonstrations; RL trains in sim, starts from sft, "
                    "and is anchored to the real demonstrations by real_coeff=0.2. In "
                    "push_cube sft had 300 simulated demonstrations and left RL "
                    "nothing to win in sim.",
                    "Reinforcement learning in the simulator can carry over to the "
                    "robot only where the simulator calls for the same actions. No "
                    "success is predicted here: a policy that explains little may "
                    "still reach its goal another way, and a few demonstrations "
                    "explain little of each other.",
                ]
            ),
            f'<p class="quiet">{escape(found.sim[0])} · {escape(found.real[0])}</p>',
        ]
    )
    path = folder / "report.html"
    write_text(path, page(title, body))
    return path


def map_table(columns: Sequence[Column], share: float) -> str:
    """Return the maps as a table, one's own case where it belongs."""
    rows: list[tuple[float, list[str]]] = [
        (
            column.share,
            [
                escape(f"{column.task}, {column.gap}"),
                unbroken(in_percent(column.share)),
                *(
                    unbroken(in_percent(column.mean(name)))
                    for name in ("real_only", "sft")
                ),
                points(column.gain("rl_only", "sft")),
                points(column.gain("rl_co", "rl_only")),
            ],
        )
        for column in columns
    ]
    own = ["<strong>your case</strong>", unbroken(in_percent(share)), *4 * ["?"]]
    rows.append((share, own))
    head = ["gap", "explained", "real_only", "sft", "RL alone - sft [points]"]
    head.append("anchored - RL alone [points]")
    return table(head, [cells for _, cells in sorted(rows, key=lambda row: row[0])])


def unbroken(text: str) -> str:
    """Return a text in HTML that stays on one line."""
    return escape(text).replace(" ", "&nbsp;")


def _cell(share: float | None) -> str:
    return "not moved" if share is None else in_percent(share)
