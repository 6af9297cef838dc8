"""What changed in a task between two sets of demonstrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from task_recordings import hidden_friction, hidden_mass, record, rollouts

from rlco.errors import DataError
from rlco.gap.calibrate.changed_task import ChangedTask, changed_task
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.verdict import Verdict
from rlco.gap.demos.replay.task_space import TaskSpaceProblem
from rlco.gap.logs.log import Log
from rlco.gap.model import load_model
from rlco.gap.reference import prepare, search
from rlco.gap.search.find_gap import find_gap, nothing_searched
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.tasks.push_cube import TASK

CUBE = "red_cube_main"
# Most effects left out: a search of all takes a minute.
OTHERS = {*EFFECTS} - {"object_mass", "contact_friction"}


@pytest.fixture(scope="module")
def before() -> Log:
    return record(hidden_mass(4.0), seed=1)[0]


@pytest.fixture(scope="module")
def nominal(before: Log) -> TaskSpaceProblem:
    return TaskSpaceProblem(TASK, before, rollouts=rollouts())


def lacks(nominal: TaskSpaceProblem, *effects: AppliedEffect) -> Verdict:
    return replace(nothing_searched(nominal, 0.0), hypothesis=Hypothesis(effects))


def since(nominal: TaskSpaceProblem, before: Log, later: Log) -> ChangedTask:
    """Return what changed where the mass of before is known."""
    mass = AppliedEffect("object_mass", CUBE, {"factor": 4.0})
    return changed_task(nominal, before, later, lacks(nominal, mass), threads=1)


def size(problem: TaskSpaceProblem, noise: np.ndarray) -> float:
    """Return how far the cube is from where it should be, in units of a noise."""
    layout = problem.layout
    cube = [layout.channels.index(f"red_cube.{axis}") for axis in "xy"]
    rows = np.isin(layout.channel, cube)
    scaled = problem.residuals([Hypothesis()])[0] / noise[layout.channel]
    return float(np.sqrt(np.mean(scaled[rows] ** 2)))


@pytest.mark.thorough
def test_what_was_lacking_before_is_known_of_later_demonstrations(
    nominal: TaskSpaceProblem, before: Log
) -> None:
    later = record(hidden_mass(4.0), seed=2)[0]
    found = since(nominal, before, later)
    without = changed_task(nominal, before, later, lacks(nominal), threads=1)
    noise = found.problem.base.noise
    # Sensors and contacts alone; without it the cube goes too far.
    assert size(found.problem.base, noise) < 1.3
    assert size(without.problem.base, noise) > 1.3 * size(found.problem.base, noise)
    # And what no name explains before is not known later.
    row = without.problem.layout.channels.index("red_cube.x")
    assert without.problem.noise[row] > 1.2 * found.problem.noise[row]
    channel = without.summary.channels.index("red_cube.x")
    lacked = without.summary.calibrated[channel]
    assert lacked < 1.3 * without.before.unknown[channel]


@pytest.mark.thorough
def test_what_changed_is_named_and_what_was_there_before_is_not(before: Log) -> None:
    slippery = hidden_mass(4.0) | hidden_friction(0.15)
    prepared = prepare(
        load_model("robosuite:push_cube"),
        record(slippery, seed=3)[0],
        before,
        None,
        1,
        lambda said, part: None,
        exclude=OTHERS,
    )
    assert prepared.summary is not None
    assert [one.name for one in prepared.summary.lacking] == ["object_mass"]
    factor = prepared.summary.lacking[0].parameters["factor"].value
    assert factor == pytest.approx(4.0, rel=0.25)
    verdict, _ = search(prepared, exclude=OTHERS)
    assert [one.name for one in verdict.effects] == ["contact_friction"]
    friction = verdict.effects[0].parameters["friction"].value
    assert friction == pytest.approx(0.15, rel=0.15)


@pytest.mark.thorough
def test_nothing_is_named_where_nothing_changed(
    nominal: TaskSpaceProblem, before: Log
) -> None:
    found = since(nominal, before, record(hidden_mass(4.0), seed=4)[0])
    assert not find_gap(found.problem, exclude=OTHERS).effects


@pytest.mark.thorough
def test_demonstrations_of_another_kind_are_refused(
    nominal: TaskSpaceProblem, before: Log
) -> None:
    def without_cube(log: Log) -> Log:
        return replace(
            log,
            recordings=tuple(
                replace(
                    one,
                    extra={k: v for k, v in one.extra.items() if "red_cube" not in k},
                )
                for one in log.recordings
            ),
        )

    with pytest.raises(DataError, match="hold other columns"):
        changed_task(nominal, before, without_cube(before), lacks(nominal))
    slow = replace(
        before,
        recordings=tuple(replace(r, time=2.0 * r.time) for r in before.recordings),
    )
    with pytest.raises(DataError, match="20 rows per second, and data= has another"):
        changed_task(nominal, before, slow, lacks(nominal))


@pytest.mark.thorough
def test_an_axis_that_changed_is_not_turned_back(
    nominal: TaskSpaceProblem, before: Log
) -> None:
    def mirrored(log: Log) -> Log:
        flip = np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        rows = [
            replace(r, command=np.asarray(r.command) * flip) for r in log.recordings
        ]
        return replace(log, recordings=tuple(rows))

    later = mirrored(before)
    found = changed_task(nominal, before, later, lacks(nominal), threads=1)
    for one, other in zip(found.problem.log.recordings, later.recordings, strict=True):
        np.testing.assert_array_equal(one.command, other.command)


@pytest.mark.thorough
def test_an_interruption_before_is_nothing_searched(before: Log) -> None:
    def stop(said: str, part: float) -> None:
        raise KeyboardInterrupt

    loaded = load_model("robosuite:push_cube")
    prepared = prepare(loaded, before, before, None, 1, stop, exclude=OTHERS)
    verdict, _ = search(prepared, exclude=OTHERS)
    assert not verdict.complete
    assert str(verdict.unexplained["note"]).startswith("Nothing was searched")
