"""The whole workflow: from a model and recordings to what the model lacks."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco

from rlco.gap.calibrate.summary import Before, Summary
from rlco.gap.compare.comparisons import (
    Comparison,
    chosen,
    first_lines,
    warned,
)
from rlco.gap.compare.problem import Problem
from rlco.gap.compare.verdict import Gap, NamedEffect, Verdict
from rlco.gap.correct.combined import combined
from rlco.gap.correct.corrected_files import write_corrected
from rlco.gap.correct.servo_files import SERVO_FILES, write_servo
from rlco.gap.diagnose.filmed import Filmed, filmed
from rlco.gap.diagnose.record_next import Motion, recommend
from rlco.gap.diagnose.regimes import Labels, label_regimes
from rlco.gap.diagnose.traces import FigureData, figure_data
from rlco.gap.diagnose.where import Where, where
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log
from rlco.gap.make_problem import (
    as_compared,
    compared_in,
    make_problem,
)
from rlco.gap.model import LoadedModel, load_model
from rlco.gap.reference import (
    Prepared,
    calibrated_model,
    calibrates,
    prepare,
    search,
)
from rlco.gap.report.calibration import (
    calibration_json,
    effects_json,
    reference_json,
)
from rlco.gap.report.compared import compared_json, comparison_lines
from rlco.gap.report.report_json import report
from rlco.gap.report.verdict_text import (
    AFTER_CALIBRATION,
    BEFORE_FITS,
    BESIDE_KNOWN,
    verdict_lines,
    where_lines,
)
from rlco.gap.search.find_gap import check_names, find_gap
from rlco.gap.torques_beside import SEARCHED, torque_warning, torques_beside
from rlco.physics.effects import load_code
from rlco.runs.whole_files import whole_folder, write_json, write_text

Progress = Callable[[str, float], None]

log = logging.getLogger(__name__)

#: The files that `Finding.write` writes, beside motions to record next.
FILES = {
    "report.json": "the verdict for programs",
    "model.xml": "the model with the effects that MJCF can express",
    "model.diff": "the changes to the model",
    "effects.yaml": "all effects, as a domain for make_env(domain=) and training",
}
_NONE = "; there is no model.xml, model.diff or effects.yaml: "
NOTHING_ELSE = f"{_NONE}nothing is searched in a simulation that diverges"
NO_CORRECTION = (
    f"{_NONE}what was measured names nothing that a model should be corrected by"
)


@dataclass(frozen=True)
class Finding:
    """What a robot's model lacks, with everything that the report contains.

    Attributes:
        verdict: The result of the search.
        where: Where the nominal model disagrees, before any fit.
        regimes: The regime of each row of each recording.
        motions: Motions to record next.
        figures: The data that the report draws.
        model: The nominal model; for a servo, with the recordings' pendulum.
        log: The recordings as compared, with notes on what was noticed.
        seconds: Total run time [s].
        complete: False where it was interrupted: this is the best so far.
        comparisons: All comparisons and their results, that of `verdict` first.
        compared: The same in sentences, with what was left out and why.
        calibration: What a calibration fitted before the search, if any.
        before: What is known from recordings made before, if any.
        filmed: What a film shows, or why there is none; None where none was wanted.
    """

    verdict: Verdict
    where: Where
    regimes: tuple[Labels, ...]
    motions: tuple[Motion, ...]
    figures: FigureData
    model: LoadedModel
    log: Log
    seconds: float
    complete: bool
    comparisons: tuple[Comparison, ...] = ()
    compared: tuple[str, ...] = ()
    calibration: Summary | None = None
    before: Before | None = None
    filmed: Filmed | str | None = None

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """The missing effects, with their parameters and rivals.

        Those that a calibration found beyond what is usual come last.
        """
        return (*self.verdict.effects, *self.beyond)

    @property
    def beyond(self) -> tuple[NamedEffect, ...]:
        """What a calibration of these recordings found beyond what is usual."""
        if self.calibration is None or self.before is not None:
            return ()
        return self.calibration.named(self.model.model)

    @cached_property
    def known(self) -> mujoco.MjModel:
        """The model with what was known before the search, if anything was."""
        if self.calibration is None:
            return self.model.model
        return calibrated_model(self.model, self.calibration.effects).model

    @property
    def gap(self) -> Gap:
        """The disagreement before and after."""
        return self.verdict.gap

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what was noticed and corrected in the recordings."""
        return self.log.notes

    @property
    def doubtful(self) -> str | None:
        """Why the verdict should not be acted on; None where nothing speaks for it."""
        first = self.comparisons[0] if self.comparisons else None
        return first.notes[0] if first is not None and first.warned else None

    def summary(self) -> list[str]:
        """Return the verdict in a few lines, a warning first."""
        lines = verdict_lines(self.verdict, self.where, self.known)
        lines += [f"  {line}" for line in comparison_lines(self.comparisons)]
        if self.doubtful is None:
            return lines
        return [f"Do not act on what follows: {self.doubtful}", *lines]

    def write(self, folder: str | Path, *, command: str = "") -> Path:
        """Write the reports, the corrected model and the motions to record next.

        The folder is there with all of them or not at all: they are written beside it,
        in ``FOLDER.unfinished``, which is renamed once it is on the disk.

        Args:
            folder: A folder that is new, or empty.
            command: The command line, which the report repeats.

        Returns:
            ``report.html``.

        Raises:
            OutputExistsError: The folder is not empty.
            RlcoError: It cannot be made, or a process that was ended has left a part of
                it, which is to be taken away first.
        """
        with whole_folder(folder) as part:
            self.write_files(part, command=command)
        return Path(folder) / "report.html"

    def write_files(self, folder: Path, *, command: str = "") -> None:
        """Write one file after another, as `write` does, into an existing folder."""
        # matplotlib takes a while to import, which a search need not wait for.
        from rlco.gap.report.film import film_of
        from rlco.gap.report.report_html import Page, page

        rows = [motion.save(folder) for motion in self.motions]
        content = report(self.verdict, self.where, self.known, rows)
        content |= compared_json(self.comparisons, self.model.model)
        content["doubtful"] = self.doubtful
        model = self.model.model
        if self.calibration is not None:
            content["calibration"] = calibration_json(self.calibration, model)
            content |= effects_json(
                self.verdict.effects, self.beyond, model, self.known
            )
        if self.calibration is not None and self.before is not None:
            content["reference"] = reference_json(self.calibration, self.before)
        # First the file for programs, so that no later failure can lose it.
        write_json(folder / "report.json", content)
        files = FILES
        if self.verdict.instability is not None:
            files = {"report.json": FILES["report.json"] + NOTHING_ELSE}
        elif self.doubtful is not None:
            files = {"report.json": FILES["report.json"] + NO_CORRECTION}
        elif self.model.servo is not None:
            write_servo(self.model, self.verdict, folder)
            files = FILES | SERVO_FILES
        else:
            write_corrected(self.model, self._corrected(), folder)
        source = Page(
            self.verdict,
            self.figures,
            self.log,
            rows,
            command,
            files,
            self.comparisons,
            self.compared,
            self.model.model,
            self.calibration,
            self.before,
            self.beyond,
            film_of(self.model, self.filmed),
            self.known,
        )
        write_text(folder / "report.html", page(source))

    def _corrected(self) -> Verdict:
        """Return the verdict with the calibration among its effects."""
        if self.calibration is None:
            return self.verdict
        return combined(self.calibration.effects, self.verdict, self.model.model)


def run_gap(
    model: str | Path,
    data: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    angles: str | None = None,
    spread: float = 0.03,
    effects_code: str | Path | None = None,
    exclude: Collection[str] = (),
    compare: str | None = None,
    reference: str | Path | None = None,
    calibrate: str | None = None,
    model_root: str | Path | None = None,
    threads: int = 2,
    film: bool = True,
    progress: Progress | None = None,
) -> Finding:
    """Identify what a robot's model lacks from recordings of the robot.

    Nothing is written; use `Finding.write`. Ctrl-C ends the search and returns the best
    result so far.

    Args:
        model: MJCF file, URDF, ``robosuite:TASK``, or ``bam:SERVO``.
        data: Recordings, see `read_log`.
        rename: ``{name in the data: name in the model}``.
        scale: ``{column in the data: factor}``, see `read_log`.
        angles: ``degrees`` or ``radians``; None to infer it from their size.
        spread: Tolerance of every parameter of the model, relative; a servo's own
            parameters are fitted.
        effects_code: A Python file that registers effects of your own.
        exclude: Names of effects that are not considered.
        compare: ``positions`` under the recorded commands, measured ``torques``, or
            ``both``, each in a search of its own. None compares positions where there
            are commands, and checks the named effects against torques; without
            commands it compares torques.
        reference: Recordings of the same robot before something in it changed: names
            what changed. Calibrates the model with them.
        calibrate: ``usual`` fits first what is always a little wrong, under priors, and
            names what remains; ``none`` does not. None: ``usual`` with a reference.
        model_root: The folder in which all files lie that the model reads, such as
            meshes; None: its own, or that of the ROS package around it.
        threads: Number of parallel simulations.
        film: Whether the report has a film of the robot, measured and simulated.
        progress: Called with a sentence and the fraction done: from 0 to less than 1
            while Ctrl-C ends what is searched, and 1 from then on.

    Raises:
        RlcoError: The model, the recordings or the options cannot be used.

    Example:
        >>> finding = run_gap("arm.xml", "logs")  # doctest: +SKIP
        >>> finding.verdict.verdict, finding.effects[0].name  # doctest: +SKIP
        ('named', 'coulomb_friction')
        >>> finding.write("gap_report")  # doctest: +SKIP
        PosixPath('gap_report/report.html')
    """
    began = time.perf_counter()
    say = progress or (lambda said, part: None)
    usual = calibrates(calibrate, reference is not None, compare)
    load_code(effects_code)
    check_names(exclude)
    loaded = load_model(model, root=model_root)
    recordings = read_log(data, loaded, rename=rename, scale=scale, angles=angles)
    asked, beside = chosen(recordings, compare)
    prepared = None
    if usual:
        first = None
        if reference is not None:
            first = read_log(
                reference, loaded, rename=rename, scale=scale, angles=angles
            )
        prepared = prepare(
            loaded, recordings, first, asked, threads, say, exclude=exclude
        )
        beside = None
        problem, base = prepared.problem, prepared.base
    else:
        problem = base = make_problem(
            loaded, recordings, threads=threads, compare=asked
        )
    used = compared_in(base)
    # A servo's bench judges its own channels beside positions: volts, current.
    beside = beside if used == asked and loaded.servo is None else None
    both = compare == "both" and beside is not None
    compared = first_lines(recordings, used, beside, both)
    for line in compared:
        log.info("%s", line)
    for note in problem.log.notes:
        log.info("note: %s", note)
    labels = label_regimes(problem)
    before = where(problem, labels=labels)
    for line in where_lines(before, _when(prepared)):
        log.info("%s", line)
    parts = 2.0 if both else 1.0

    def on_step(said: str, part: float) -> None:
        say(said, SEARCHED * part / parts)

    if prepared is None:
        verdict = find_gap(problem, spread=spread, exclude=exclude, on_step=on_step)
    else:
        verdict, prepared = search(prepared, exclude=exclude, on_step=on_step)
    comparisons = [warned(Comparison(used, verdict, verdict.gap), torque_warning(base))]
    motions, complete = _to_record_next(base, verdict, say)
    if complete and beside is not None and verdict.instability is None:
        options = {"spread": spread, "exclude": exclude} if both else None
        log_of_both = replace(recordings, notes=problem.log.notes)
        other, complete = torques_beside(loaded, log_of_both, verdict, options, say)
        comparisons.append(other)
    say("preparing the figures", 1.0)
    figures = figure_data(problem, verdict, before, labels)
    shown = filmed(problem, verdict, figures.stretches) if film else None
    return Finding(
        verdict=verdict,
        where=before,
        regimes=tuple(labels),
        motions=motions,
        figures=figures,
        model=as_compared(loaded, base),
        log=problem.log,
        seconds=time.perf_counter() - began,
        complete=complete,
        comparisons=tuple(comparisons),
        compared=tuple(compared),
        calibration=None if prepared is None else prepared.summary,
        before=None if prepared is None else prepared.before,
        filmed=shown,
    )


def _when(prepared: Prepared | None) -> str:
    """Return when the disagreement before a search is computed."""
    if prepared is None or prepared.summary is None:
        return BEFORE_FITS
    return AFTER_CALIBRATION if prepared.before is None else BESIDE_KNOWN


def _to_record_next(
    problem: Problem, verdict: Verdict, say: Progress
) -> tuple[tuple[Motion, ...], bool]:
    """Return motions to record next, and whether the search for them completed."""
    if not verdict.complete or verdict.instability is not None:
        return (), verdict.complete
    say("looking for more informative motions", SEARCHED)
    try:
        return tuple(recommend(problem, verdict)), True
    except KeyboardInterrupt:
        return (), False
