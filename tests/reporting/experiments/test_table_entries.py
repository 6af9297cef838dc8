"""What of an experiment's file stands in each entry of its table."""

from __future__ import annotations

from pathlib import Path

from rlco.reporting.experiments.entries import labels_of
from rlco.reporting.experiments.results import table_entries
from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import expand
from rlco.runs.compare.reading.read_experiment import read_experiment

#: The first group has no run of the first method, which is not run there.
TEXT = """\
over: {seed: [0], demos: [5, 20], sim: [0, 300]}
without: [{demos: 5, sim: 300}]
jobs: {one: {script: s.py, options: {d: "{demos}", s: "{sim}"}}}
table:
  by: demos
  methods:
    with sim: {job: one, at: {sim: 300}}
    alone: {job: one, at: {sim: 0}}
    with 20: {job: one, at: {sim: 0, demos: 20}}
"""


def test_entries_know_their_line_and_what_their_method_always_has(
    tmp_path: Path,
) -> None:
    (tmp_path / "s.py").write_text("print(1)\n")
    path = tmp_path / "small.yaml"
    path.write_text(TEXT)
    experiment = read_experiment(path)
    store = Store(tmp_path / "out", None)
    found = table_entries(experiment, expand(experiment), store)
    assert [(one.group, one.label) for one in found] == [
        ("demos 5", "alone"),
        ("demos 5", "with 20"),
        ("demos 20", "with sim"),
        ("demos 20", "alone"),
        ("demos 20", "with 20"),
    ]
    assert labels_of(found) == ["with sim", "alone", "with 20"]
    fixed = {one.label for one in found if "demos" in one.always}
    assert fixed == {"with 20"}
