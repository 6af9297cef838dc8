"""A run's report: one self-contained HTML file.

Everything is read from the run directory, so a report can be written again at any
time. Images and videos are embedded; no script, font or style is loaded from
elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import cast

from PIL import Image

from rlco.errors import RlcoError
from rlco.files import Fields, read_json, reading
from rlco.files.places import check_links
from rlco.files.texts import read_text
from rlco.reporting.html import data_address, definitions, figure, page
from rlco.reporting.plot_style import READING, styles
from rlco.reporting.result_tables import difference_table, percent, success_table
from rlco.reporting.statistics import ResultRow, rate_interval
from rlco.runs.metrics import read_metrics
from rlco.runs.results_file import read_results
from rlco.runs.whole_files import write_text

_VIDEO_LIMIT = 4_000_000  # [byte]; a longer one is named, not embedded


def write_report(
    run_dir: str | Path, *, title: str | None = None, notes: Sequence[str] = ()
) -> Path:
    """Write ``report.html`` into a run directory from the files there.

    Call it after the run has ended: its status and run time are final only then.

    Args:
        run_dir: A run directory: run.json, and where present results.json,
            metrics.csv, config.yaml, plots/*.png and videos/*.mp4.
        title: The headline; by default the success rates of results.json.
        notes: Sentences of the recipe, below the headline.

    Returns:
        The file.

    Raises:
        RlcoError: The folder is not a run directory, a file in it is damaged, or a link
            leads out of it.
    """
    run_dir = Path(run_dir)
    if not (run_dir / "run.json").is_file():
        raise RlcoError(
            f"{str(run_dir)!r} is not a run directory: it has no run.json; give the "
            "folder that a recipe wrote."
        )
    check_links(run_dir)
    info = read_json(run_dir / "run.json", advice="give the folder of another run")
    results = run_dir / "results.json"
    found = read_results(results, of_recipe=True) if results.is_file() else []
    rows = cast(list[ResultRow], found)
    headline = title or _headline(rows) or f"A run of {info.text('recipe')}"
    body = "\n".join(
        part
        for part in (
            _header(info, headline, notes),
            _simulated(rows),
            success_table(rows),
            difference_table(rows),
            _figures(run_dir),
            _videos(run_dir),
            _details(run_dir, info),
        )
        if part
    )
    path = run_dir / "report.html"
    write_text(path, page(headline, body))
    return path


def _headline(rows: Sequence[ResultRow]) -> str:
    """Return the success rate of the last method of the comparison, then the others."""
    if not rows:
        return ""
    domains = {row["domain"] for row in rows}
    domain = "stand_in" if "stand_in" in domains else rows[0]["domain"]
    here = [row for row in rows if row["domain"] == domain]
    methods = list(styles(row["method"] for row in here))
    rates = {
        method: rate_interval([row for row in here if row["method"] == method])
        for method in methods
    }
    main = methods.pop()
    tasks = " and ".join(dict.fromkeys(row["task"] or "its task" for row in here))
    often = percent(rates[main].estimate)
    text = f"{main} solves {tasks} in {often} of episodes in {domain}"
    others = [f"{method} in {percent(rates[method].estimate)}" for method in methods]
    return f"{text}; {', '.join(reversed(others))}" if others else text


def _header(info: Fields, headline: str, notes: Sequence[str]) -> str:
    minutes, seconds = divmod(round(info.number("seconds")), 60)
    facts = (
        f"{info.text('started')} · {minutes} min {seconds} s · {info.text('status')}"
    )
    return (
        f'<header>\n<p class="kicker">rlco · {escape(info.text("recipe"))}</p>\n'
        f'<h1>{escape(headline)}</h1>\n<p class="quiet">{escape(facts)}</p>\n'
        "</header>" + "".join(f"\n<p>{escape(note)}</p>" for note in notes)
    )


def _simulated(rows: Sequence[ResultRow]) -> str:
    text = (
        "<p><strong>What is simulated.</strong> Every success rate here was measured "
        "in a simulator; no robot moved for it.</p>"
    )
    if any(row["domain"] == "stand_in" for row in rows):
        text += (
            "<p><code>stand_in</code> is a second simulator, not a robot. It plays the "
            "robot's part, with other friction, masses, delay and sensors than "
            "<code>sim</code>, the simulator as built. Unless "
            "<code>train_domain</code> names it, training uses it only through "
            "demonstrations recorded there.</p>"
        )
    if any(row["domain"] == "locked" for row in rows):
        text += (
            "<p><code>locked</code> is a third simulator, of the same kind as "
            "<code>stand_in</code> with other values. No setting was chosen by success "
            "in it, and no policy is trained in it by reinforcement.</p>"
        )
    return f"<aside>{text}</aside>"


def _figures(run_dir: Path) -> str:
    known = list(READING)
    found = []
    for path in sorted((run_dir / "plots").glob("*.png")):
        with reading(path, what="figure"), Image.open(path) as image:
            about = {key: str(value) for key, value in image.info.items()}
        title = about.get("Title") or path.stem.replace("_", " ").capitalize()
        place = known.index(title) if title in known else len(known)
        alt = f"{title}. {about.get('Description', '')}"
        drawn = figure(path.read_bytes(), alt, about.get("Comment", ""))
        found.append((place, path.name, drawn))
    if not found:
        return ""
    return "<h2>Figures</h2>\n" + "\n".join(html for _, _, html in sorted(found))


def _videos(run_dir: Path) -> str:
    parts = []
    for path in sorted((run_dir / "videos").glob("*.mp4")):
        name = f"<code>videos/{escape(path.name)}</code>"
        if path.stat().st_size > _VIDEO_LIMIT:
            parts.append(f'<p class="quiet">{name}</p>')
        else:
            with reading(path, what="video"):
                source = data_address(path.read_bytes(), "video/mp4")
            parts.append(
                f'<figure><video controls muted loop src="{source}"></video>'
                f"<figcaption>{name}</figcaption></figure>"
            )
    return "<h2>Videos</h2>\n" + "\n".join(parts) if parts else ""


def _details(run_dir: Path, info: Fields) -> str:
    machine, versions = info.group("machine"), info.mapping("versions", {})
    graphics = ", ".join(map(str, machine.sequence("gpus"))) or "no GPU"
    cores = machine.integer("cores")
    facts = {
        "commit": info.text("commit", "unknown"),
        "machine": f"{machine.text('processor')}, {cores} cores, {graphics}",
        "system": machine.text("system"),
        "versions": ", ".join(f"{name} {one}" for name, one in versions.items()),
        "resumed": f"{len(info.sequence('resumed'))} times",
    }
    parts = [
        f"<h2>Make it again</h2>\n<pre>{escape(info.text('command'))}</pre>",
        definitions(facts.items()),
    ]
    config, metrics = run_dir / "config.yaml", run_dir / "metrics.csv"
    if config.is_file():
        text = escape(read_text(config))
        parts.append(
            f"<details><summary>Configuration</summary><pre>{text}</pre></details>"
        )
    history = read_metrics(metrics) if metrics.is_file() else []
    if history:
        last = {name: f"{value:.6g}" for name, value in history[-1].items()}
        parts.append(
            "<details><summary>Metrics of the last step</summary>"
            f"{definitions(last.items())}</details>"
        )
    return "\n".join(parts)
