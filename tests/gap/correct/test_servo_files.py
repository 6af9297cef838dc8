"""A corrected servo: what MJCF holds of it, and what else is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from bench_runs import goals, write_bench, write_run

from rlco.gap import load_model, make_problem, read_log
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.servo.plant import SERVO_NUMBERS
from rlco.gap.compare.verdict import Gap, Verdict
from rlco.gap.correct.servo_files import write_servo
from rlco.gap.logs.log import Array
from rlco.gap.make_problem import as_compared
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import read_effects

OWN = AppliedEffect(
    SERVO_NUMBERS,
    "servo",
    {
        "damping": 0.5,
        "armature": -0.2,
        "friction": -1.0,  # MuJoCo's friction creeps a little where the bench's holds
        "gain": 0.25,
        "feedback": 0.4,
        "zero": 0.03,
    },
)
LIMIT = AppliedEffect("torque_limit", "servo", {"limit": 0.3})
LOSS = AppliedEffect("drive_loss", "servo", {"loss": 0.9})
GAIN = AppliedEffect("actuator_gain", "servo", {"factor": 1.5})
KP = 300.0


def verdict(*effects: AppliedEffect) -> Verdict:
    gap = Gap("rad", 1.0, 1.0, 0.1, 0.1, 0.01)
    hypothesis = Hypothesis((OWN, *effects))
    return Verdict(
        True, "named", (), gap, {}, (), 1.0, hypothesis, train=(0,), heldout=(0,)
    )


def written(tmp_path: Path, *effects: AppliedEffect) -> Path:
    loaded = load_model("bam:xl330")
    log = read_log(write_bench(tmp_path / "logs", gains=(KP,)), loaded)
    out = tmp_path / "out"
    out.mkdir()
    write_servo(as_compared(loaded, make_problem(loaded, log)), verdict(*effects), out)
    return out


def under_firmware(model: mujoco.MjModel, sent: Array, start: float) -> Array:
    """Step a servo's model under the firmware that its comments describe."""
    data = mujoco.MjData(model)
    data.qpos[0] = start
    reported = np.empty_like(sent)
    for row, goal in enumerate(sent):
        reported[row] = data.qpos[0]
        duty = 0.00287738 * KP * (goal - data.qpos[0])
        data.ctrl[0] = np.clip(duty, -1.0, 1.0)
        mujoco.mj_step(model, data)
    return reported


@pytest.mark.parametrize("effects", [(), (LIMIT,)], ids=["own numbers", "a limit"])
def test_mujoco_moves_the_written_model_as_the_bench_does(
    tmp_path: Path, effects: tuple[AppliedEffect, ...]
) -> None:
    out = written(tmp_path, *effects)
    loaded = load_model("bam:xl330")
    problem = make_problem(loaded, read_log(tmp_path / "logs", loaded))
    (sines, _) = problem.log.recordings
    simulated = problem.traces(Hypothesis((OWN, *effects)), 0)["simulated"][:, 0]
    assert sines.position is not None
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    track = under_firmware(model, goals("sines"), sines.position[0, 0])
    np.testing.assert_allclose(track, simulated, atol=2e-4)
    assert np.ptp(simulated) > 0.5


def test_what_no_mjcf_holds_is_said_and_listed(tmp_path: Path) -> None:
    out = written(tmp_path, LOSS, GAIN)
    text = (out / "model.xml").read_text()
    assert "not in this file: the firmware" in text
    assert (
        "not in this file but in effects.yaml: drive_loss at servo, loss = 0.9" in text
    )
    assert "actuator_gain, the firmware's kp times 1.5" in text
    assert read_effects(out / "effects.yaml").effects == (LOSS, GAIN)
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    # The firmware's gain leaves the torque of the full duty, 0.502086 N m as published.
    assert model.actuator_gainprm[0, 0] == pytest.approx(1.25 * 0.502086, rel=1e-5)


def test_the_pendulum_is_that_of_the_recordings(tmp_path: Path) -> None:
    file = write_run(tmp_path, "run", KP, "sines", seconds=5.0)
    file.write_text(file.read_text().replace('"mass": 0.49', '"mass": 0.35'))
    loaded = load_model("bam:xl330")
    compared = as_compared(loaded, make_problem(loaded, read_log(file, loaded)))
    assert compared.model.body("arm").mass[0] == pytest.approx(0.35)
    assert 'mass="0.35"' in compared.source


def test_a_model_without_a_servo_is_a_programmers_mistake(tmp_path: Path) -> None:
    loaded = replace(load_model("bam:xl330"), servo=None)
    with pytest.raises(ValueError, match="is no servo on a pendulum"):
        write_servo(loaded, verdict(), tmp_path)
