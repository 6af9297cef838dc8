"""The run directory: created, never overwritten, resumed; and a recipe's entry.

torch is imported only once a run starts, so help and wrong options answer at once.
"""

from __future__ import annotations

import inspect
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rlco.errors import NonFiniteError, RlcoError
from rlco.reporting.headless import choose_gl
from rlco.runs import checkpoints, run_folder
from rlco.runs.config import RunOptions, parse, to_yaml
from rlco.runs.endings import (
    STORAGE,
    Stopped,
    ending,
    is_out_of_memory,
    stop_on_signals,
)
from rlco.runs.progress import Progress
from rlco.runs.resumed import (
    check_checkpoint,
    check_unchanged,
    inputs_of,
    options_by_name,
)
from rlco.runs.run_log import LogFile, Printable
from rlco.runs.tables import Tables
from rlco.runs.whole_files import json_text, remove_parts, write_json, write_text

if TYPE_CHECKING:
    from rlco.reporting.statistics import ImitationRow, ResultRow

log = logging.getLogger("rlco.run")


def run_recipe[C](
    main: Callable[[C], None],
    config_class: type[C],
    argv: Sequence[str] | None = None,
    *,
    loads: str = "torch",
) -> None:
    """Start a recipe: read its options, run it, turn wrong input into one sentence.

    Wrong input ends with its message on stderr and status 2, a full or read-only disk
    and a full memory with status 1, Ctrl-C with status 130, SIGTERM and SIGHUP with 143
    and 129. Every other exception keeps its traceback: it is a defect.

    Args:
        main: The recipe; its file names the recipe and the folder of its YAML.
        config_class: The dataclass of its options.
        argv: The arguments; the command line's where absent.
        loads: What takes the first seconds to import: it is said before.
    """
    choose_gl()
    logger = logging.getLogger("rlco")
    logger.setLevel(logging.INFO)
    logger.propagate = False  # some libraries print what reaches the root, again
    # TorchRL reads it at its import, and says a line for each storage without it.
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
    console = logging.StreamHandler()
    console.setFormatter(Printable("%(message)s"))
    logger.addHandler(console)
    stop_on_signals()
    try:
        argv = sys.argv[1:] if argv is None else argv
        config = parse(config_class, argv, inspect.getfile(main))
        if loads not in sys.modules:
            log.info("loading %s", loads)
        main(config)
    except (RlcoError, OSError, MemoryError, RuntimeError) as error:
        ended = ending(error)
        if ended is None:
            raise
        sentence, status = ended
        sys.stderr.write(f"error: {sentence}\n")
        raise SystemExit(status) from None
    except KeyboardInterrupt as stop:
        number = stop.number if isinstance(stop, Stopped) else signal.SIGINT
        raise SystemExit(128 + number) from None
    finally:
        logger.removeHandler(console)


class Run:
    """One run and its directory; use it as a context manager.

    Its start seeds every random number and sets torch's threads. Iterations are
    counted from 1; step 0 is what was before the first. A resumed run goes on after
    its last checkpoint, from the same random state, and ends with the same
    metrics.csv as a run that was never stopped, where each iteration starts from
    resets and the recipe puts its own state into :meth:`save_checkpoint`.

    Args:
        config: The recipe's options.
        recipe: The recipe's name.
        root: Where run directories are made unless ``config.out`` names one.

    Raises:
        OutputExistsError: The directory exists; nothing in it was touched.
        RlcoError: It cannot be made, or the run to resume is another recipe's or is
            still being written by another process.

    Example:
        >>> import tempfile
        >>> options = RunOptions(out=tempfile.mkdtemp() + "/run")
        >>> with Run(options, "demo") as run:
        ...     for iteration in run.iterations(3):
        ...         run.log_metrics(iteration, {"loss": 1 / iteration})
        ...         file = run.save_checkpoint(iteration, {"weight": 1.0})
        >>> with Run(RunOptions(resume=options.out), "demo") as run:
        ...     print(run.load_checkpoint(), list(run.iterations(5)))
        {'weight': 1.0} [4, 5]
    """

    def __init__(
        self, config: RunOptions, recipe: str, *, root: Path = Path("outputs")
    ) -> None:
        self.recipe = recipe
        self._progress = Progress(recipe)
        self.resumed = config.resume is not None
        self._keep = config.keep_checkpoints
        if config.resume is not None:
            self.path = Path(config.resume)
            info = run_folder.read_info(self.path, recipe)
            inputs = check_unchanged(self.path, info, config)
            self._lock = run_folder.lock(self.path)
            self._info = dict(info.content) | {"inputs": inputs}
            self._info["resumed"].append(run_folder.command_line())
        else:
            self._info = run_folder.origin(recipe)
            self._info["inputs"] = inputs_of(config)
        self._info["options"] = options_by_name(config)
        self._info["status"] = "running"
        options = to_yaml(config, leave_out=("out", "resume"))
        if not self.resumed:
            first = {"config.yaml": options, "run.json": json_text(self._info)}
            self.path = run_folder.create(
                config.out, config.name, config.seed, recipe, root, first
            )
            self._lock = run_folder.lock(self.path)
        self.checkpoints = self.path / "checkpoints"
        self._start: float = time.perf_counter() - self._info["seconds"]
        self._open_log()
        try:
            self._open_tables()
            if self.resumed:
                write_text(self.path / "config.yaml", options)
            self._write_info("running")
        except BaseException:
            self._close_log()
            os.close(self._lock)  # once that is corrected, it is tried again
            raise
        import torch

        from rlco.runs.state_files import seed_everything

        torch.set_num_threads(config.threads)
        seed_everything(config.seed)

    def _open_tables(self) -> None:
        # The last iteration that a checkpoint holds; None before the first.
        self.step = checkpoints.go_on_from(
            self.checkpoints, self._info.get("checkpoint")
        )
        remove_parts(self.path)
        self._tables = Tables(self.path, self.step)
        self._rng: Mapping[str, Any] | None = None
        if self.resumed:
            self._tables.open_board()

    def _open_log(self) -> None:
        self._handler = LogFile(self.path / "log.txt", encoding="utf-8")
        self._handler.setFormatter(
            Printable("%(asctime)s %(levelname)s %(name)s: %(message)s")
        )
        logging.getLogger("rlco").addHandler(self._handler)

    def _close_log(self) -> None:
        logging.getLogger("rlco").removeHandler(self._handler)
        self._handler.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        status = "finished"
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            status = "interrupted"
            log.warning("interrupted; resume=%s continues this run", self.path)
        elif kind is not None and error is not None:
            status = "failed"
            # For the file alone: on the screen the error speaks for itself.
            what = (status, (), (kind, error, trace))
            self._handler.handle(log.makeRecord(log.name, logging.ERROR, "", 0, *what))
            full = isinstance(error, OSError) and error.errno in STORAGE
            if full or is_out_of_memory(error):
                log.warning("resume=%s continues this run then", self.path)
            if isinstance(error, NonFiniteError) and self.step is not None:
                log.warning("the last good state is %s", self._last_checkpoint())
        try:
            self._close_log()
            self._write_info(status)
            self._tables.close()
        except OSError:
            if error is None:  # else the first one says why
                raise
        finally:
            os.close(self._lock)

    @property
    def seconds(self) -> float:
        """Time spent in this run, the parts before a resume included [s]."""
        return time.perf_counter() - self._start

    @property
    def plots(self) -> Path:
        """The folder for figures."""
        return _made(self.path / "plots")

    @property
    def videos(self) -> Path:
        """The folder for videos."""
        return _made(self.path / "videos")

    def iterations(
        self, total: int, progress: Callable[[int], str] | None = None
    ) -> Iterator[int]:
        """Count the iterations that are left, 1 to ``total``, with a progress bar.

        A resumed run gets its random state back before its first one. Without a
        terminal a line now and then, and one at the end, says how far it is.

        Args:
            total: Number of iterations.
            progress: How far it is after an iteration, in words; by default
                "3 of 15". An iteration of several updates may count those.
        """
        if self._rng is not None:
            from rlco.runs.state_files import set_rng_state

            set_rng_state(self._rng)
            self._rng = None
        yield from self._progress.count((self.step or 0) + 1, total, progress)

    def log_metrics(self, step: int, row: Mapping[str, Any]) -> None:
        """Write one row of metrics.csv; see :meth:`MetricsFile.append`. No times."""
        self._tables.append("metrics", self._unsaved(step), row)
        self._progress.show(self._tables.metrics.last)

    def log_timings(self, step: int, row: Mapping[str, Any]) -> None:
        """Write one row of timings.csv: what differs from run to run [s]."""
        self._tables.append("timings", self._unsaved(step), row)

    def _unsaved(self, step: int) -> int:
        if self.step is not None and step <= self.step:
            # Resuming keeps what the checkpoint knows; this row would be lost.
            raise ValueError(f"step {step} is logged after its checkpoint was saved")
        return step

    def save_checkpoint(
        self, step: int, state: Any, *, keep: int | None = None
    ) -> Path:
        """Save state, and the random numbers', as the last act of an iteration.

        Args:
            step: The iteration just done.
            state: As :func:`rlco.runs.state_files.save_state` takes it.
            keep: Older checkpoints beyond so many are removed; by default the option
                ``keep_checkpoints``.

        Returns:
            The file.

        Raises:
            NonFiniteError: A tensor holds NaN or infinity; nothing is written.
        """
        from rlco.finite import check_saved, named_tensors
        from rlco.runs.state_files import rng_state

        check_saved(f"the checkpoint of iteration {step}", named_tensors(state))
        self._tables.sync()
        digest = self._tables.metrics.digest()
        path = checkpoints.save_checkpoint(
            self.checkpoints,
            step,
            {"state": state, "rng": rng_state(), "metrics": digest},
            keep=self._keep if keep is None else keep,
        )
        self.step = step
        self._write_info("running")
        return path

    def load_checkpoint(self) -> Any:
        """Return the last checkpoint's state; None where a run starts afresh.

        Raises:
            CheckpointError: It cannot be read, holds NaN or infinity or no state of
                random numbers, or metrics.csv is not what it was when it was saved.
        """
        from rlco.finite import check_loaded, named_tensors
        from rlco.runs.state_files import check_rng_state, load_state

        if self.step is None:
            return None
        path = self._last_checkpoint()
        saved = load_state(path)
        check_checkpoint(path, saved, self._tables.metrics)
        advice = "take the file away to resume from the one before, if there is one"
        check_loaded(str(path), named_tensors(saved["state"]), advice=advice)
        check_rng_state(path, saved["rng"])
        self._rng = saved["rng"]
        return saved["state"]

    def _last_checkpoint(self) -> Path:
        return list(checkpoints.checkpoint_files(self.checkpoints).values())[-1]

    def save_results(
        self,
        rows: Sequence[ResultRow],
        *,
        imitation: Sequence[ImitationRow] = (),
    ) -> None:
        """Write results.json: what every evaluated policy reached.

        Args:
            rows: What it reached in simulators.
            imitation: How far it is from demonstrations.
        """
        content = {"seconds": self.seconds, "rows": list(rows)}
        if imitation:
            content["imitation"] = list(imitation)
        write_json(self.path / "results.json", content)

    def stage_options[C: RunOptions](
        self, config: C, folder: str, *, anew: Iterable[str] = ()
    ) -> C:
        """Return a stage's options: where it is resumed, those it was started with.

        Args:
            config: The options of a stage that starts.
            folder: The stage's folder in this run.
            anew: Options that are taken from ``config`` all the same: paths, since a
                run may have been moved.

        Raises:
            ConfigError: The stage's ``config.yaml`` cannot be read.
        """
        path = self.path / folder
        if not (self.resumed and path.exists()):
            return config
        saved = parse(type(config), [f"resume={path}"], folder)
        return replace(saved, **{name: getattr(config, name) for name in anew})

    def stage[C: RunOptions](self, config: C, recipe: str, folder: str) -> Run:
        """Start a run inside this one, or go on with it where this one is resumed."""
        path = self.path / folder
        done = path.exists() and self.resumed
        out, resume = (None, str(path)) if done else (str(path), None)
        run = Run(replace(config, out=out, resume=resume), recipe)
        run._progress.name = path.name  # two stages may be of one recipe
        return run

    def _write_info(self, status: str) -> None:
        self._info |= {
            "status": status,
            "seconds": self.seconds,
            "checkpoint": self.step,
        }
        write_json(self.path / "run.json", self._info)


def _made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder
