"""The report: whole in one file, honest, and right about the numbers."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from rlco.errors import RlcoError
from rlco.reporting.plots import save_figure, success_bars
from rlco.reporting.report import write_report
from rlco.reporting.statistics import ResultRow, paired_rows
from rlco.run import Run
from rlco.runs.config import RunOptions


def row(method: str, domain: str, successes: int, seed: int = 0) -> ResultRow:
    return {
        "method": method,
        "task": "push_cube",
        "policy": "gaussian",
        "domain": domain,
        "variation": None,
        "seed": seed,
        "episodes": 20,
        "successes": successes,
    }


ROWS = [
    row("sft", "sim", 12),
    row("sft", "stand_in", 5),
    row("rl_co", "sim", 19),
    row("rl_co", "stand_in", 17),
]


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    options = RunOptions(out=str(tmp_path / "run"), name="<first>")
    with Run(options, "quickstart") as run:
        run.log_metrics(1, {"loss_bc_real": 0.125})
        run.save_results(ROWS)
        save_figure(success_bars(ROWS), run.plots / "success.png")
        (run.videos / "episode.mp4").write_bytes(b"a short film")
    return run.path


class Page(HTMLParser):
    """Collects the text, the addresses and the tags left open of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.addresses: list[str] = []
        self.alt = ""
        self.open: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href"):
                self.addresses.append(value or "")
            if name == "alt":
                self.alt = value or ""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words += data.split()

    @property
    def text(self) -> str:
        return " ".join(self.words)


def read(path: Path) -> Page:
    return Page(path.read_text("utf-8"))


def test_report_needs_nothing_but_itself(run_dir: Path) -> None:
    path = write_report(run_dir)
    page = read(path)
    assert page.open == []
    assert [address[:22] for address in page.addresses] == [
        "data:image/png;base64,",
        "data:video/mp4;base64,",
    ]
    assert not re.search(r"https?:|<script|@import|url\(", path.read_text("utf-8"))


@pytest.mark.parametrize("name", ["videos/other.mp4", "config.yaml", "plots"])
def test_no_report_holds_what_lies_elsewhere(run_dir: Path, name: str) -> None:
    outside = run_dir.parent / "outside"
    outside.write_text("not of this run")
    link = run_dir / name
    if link.is_dir():
        link.rename(run_dir.parent / "moved")
        outside = run_dir.parent / "moved"
    link.unlink(missing_ok=True)
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(outside)
    with pytest.raises(RlcoError, match=f"'{name}' of run folder .* leads out of it"):
        write_report(run_dir)


def test_headline_and_table_hold_the_numbers(run_dir: Path) -> None:
    text = read(write_report(run_dir)).text
    assert "rl_co solves push_cube in 85 % of episodes in stand_in; sft in 25 %" in text
    # Wilson's interval of 17 of 20: [0.640, 0.948]
    assert "85 % 64 to 95 % · 17 of 20" in text
    assert "95 % Wilson intervals" in text


def test_several_seeds_are_a_mean_with_its_interval(run_dir: Path) -> None:
    with Run(RunOptions(name="<first>", resume=str(run_dir)), "quickstart") as run:
        run.save_results([row("sft", "sim", k, s) for s, k in enumerate((14, 16, 18))])
    text = read(write_report(run_dir)).text
    # 0.7, 0.8, 0.9: mean 0.8, t interval [0.552, 1.048], shown up to 100 %
    assert "80 % 55 to 100 % · 48 of 60, 3 seeds" in text
    assert "t intervals of the mean over seeds" in text


def counted(method: str, solved: list[int], ever: list[int], seed: int) -> ResultRow:
    lost = sum(e and not s for s, e in zip(solved, ever, strict=True))
    return {
        **row(method, "sim", sum(solved), seed),
        "ever_successes": sum(ever),
        "lost": lost,
        "outcomes": solved,
        "ever": ever,
        "states_seed": seed,
    }


def solved(count: int) -> list[int]:
    return [1] * count + [0] * (20 - count)


def test_ever_and_lost_again_stand_beside_success_at_the_end(run_dir: Path) -> None:
    with Run(RunOptions(name="<first>", resume=str(run_dir)), "quickstart") as run:
        run.save_results([counted("sft", solved(8), solved(12), 0)])
    text = read(write_report(run_dir)).text
    assert "8 of 20 ever 60 % · lost again 20 %" in text
    assert "Lost again: ever solved, but not at the end" in text
    assert "Differences" not in text  # of a single method


def test_differences_are_paired_within_a_seed(run_dir: Path) -> None:
    rows = [
        counted("rl_co", solved(18), solved(18), 0),
        counted("sft", solved(8), solved(12), 0),
        counted("rl_only", solved(16), solved(18), 0),
    ]
    with Run(RunOptions(name="<first>", resume=str(run_dir)), "quickstart") as run:
        run.save_results(rows)
    text = read(write_report(run_dir)).text
    gain = paired_rows(rows[0], rows[1])
    reach = f"{100 * gain.low:+.0f} to {100 * gain.high:+.0f}"
    assert f"rl_co minus sft +50 points {reach} · 20 states" in text
    assert "rl_co minus rl_only +10 points" in text
    assert "rl_only minus sft" not in text


def test_differences_over_seeds_leave_out_what_one_method_lacks(run_dir: Path) -> None:
    rows = [
        counted("rl_co", solved(n), solved(n), s) for s, n in enumerate((18, 16, 20))
    ]
    rows += [counted("sft", solved(n), solved(n), s) for s, n in enumerate((8, 10))]
    with Run(RunOptions(name="<first>", resume=str(run_dir)), "quickstart") as run:
        run.save_results(rows)
    text = read(write_report(run_dir)).text
    # .5 and .3: mean .4, s / sqrt(2) = .1, t(.975, 1 d.o.f.) = 12.7062
    assert "rl_co minus sft +40 points -87 to +167 · 2 seeds" in text


def test_report_says_what_is_simulated(run_dir: Path) -> None:
    text = read(write_report(run_dir)).text
    assert "no robot moved for it" in text
    assert "stand_in is a second simulator, not a robot" in text


def test_figure_has_its_description_and_how_to_read_it(run_dir: Path) -> None:
    page = read(write_report(run_dir))
    assert page.alt.startswith("Success rate. n = 20 episodes per bar")
    assert "Compare the methods within one simulator" in page.text


def test_report_says_how_it_was_made(run_dir: Path) -> None:
    text = read(write_report(run_dir)).text
    assert "uv run" in text
    assert re.search(r"versions python 3\.12\.\d+, rlco", text)
    assert "loss_bc_real 0.125" in text
    assert "name: <first>" in text  # escaped, or the parser would see a tag


def test_recipes_own_words_are_escaped(run_dir: Path) -> None:
    page = read(write_report(run_dir, title="a < b", notes=["1 & 2 <b>not bold</b>"]))
    assert "a < b" in page.text
    assert "1 & 2 <b>not bold</b>" in page.text


def test_results_of_no_task_are_reported_without_its_name(run_dir: Path) -> None:
    results = run_dir / "results.json"
    results.write_text(results.read_text().replace('"push_cube"', "null"))
    text = read(write_report(run_dir)).text
    assert "rl_co solves its task in 85 % of episodes in stand_in" in text


def test_run_without_results_has_a_report(tmp_path: Path) -> None:
    with Run(RunOptions(out=str(tmp_path / "run")), "record_demos") as run:
        pass
    text = read(write_report(run.path)).text
    assert "A run of record_demos" in text
    assert "Success" not in text.replace("success rate", "")


def test_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RlcoError, match="is not a run directory"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []
