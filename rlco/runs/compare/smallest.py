"""An experiment cut down to what shows in a minute whether all of it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rlco.files import Fields, read_yaml
from rlco.runs.compare.experiment import Experiment, JobKind, Published

#: Options that take long, where a job or its script's debug.yaml has them.
_SHORT: dict[str, Any] = {
    "pretrain_scenes": 64,
    "pretrain_passes": 1,
    "horizon": 16,
    "final_episodes": 1,
    "batch_size": 32,
    "iterations": 2,
    "updates": 10,
    "log_every": 10,
    "eval_every": 2,
    "eval_episodes": 1,
    "curve_episodes": 1,
}
#: How many a script records itself, where its debug.yaml has them; elsewhere folders.
_DEMOS = ("sim_demos", "real_demos", "heldout_demos")


def smallest(experiment: Experiment) -> Experiment:
    """Return an experiment with one value of each variable and short jobs.

    Each job has its script's ``config=debug``, and less of what else takes long. What
    it comes to means nothing.
    """
    over = {name: values[:1] for name, values in experiment.over.items()}
    table = experiment.table
    known = {name: values[0] for name, values in over.items()}
    lines = tuple(
        replace(line, at={name: known[name] for name in line.at})
        for line in table.lines
    )
    beside: tuple[Published, ...] = tuple(
        one for one in table.published if one.at.items() <= known.items()
    )
    return replace(
        experiment,
        over=over,
        without=(),
        jobs={name: _short(job) for name, job in experiment.jobs.items()},
        table=replace(table, lines=lines, published=beside, curve_episodes=None),
    )


def _short(job: JobKind) -> JobKind:
    options = dict(job.options)
    small: Mapping[str, Any] = {}
    debug = job.path.with_suffix("") / "debug.yaml"
    if debug.is_file():
        small = Fields(read_yaml(debug) or {}, f"file {str(debug)!r}").content
        options = {name: value for name, value in options.items() if name not in small}
        # The smallest recordings have four episodes, of which a part may be asked for.
        options |= {"episodes": "0-3"} if "episodes" in options else {}
        options["config"] = "debug"
    names = options.keys() | small.keys()
    options |= {name: value for name, value in _SHORT.items() if name in names}
    options |= dict.fromkeys((name for name in _DEMOS if name in small), 1)
    return replace(job, options=options, minutes=0.1)
