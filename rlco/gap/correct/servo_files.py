"""The corrected servo on its pendulum, and what of it no MJCF can hold.

`model.xml` has the servo's own numbers as fitted, and the effects that change a model.
Its joint's ``ref`` is the encoder's zero, so that its position is what the encoder
reports. The firmware is not in it: MuJoCo 3.9 has no actuator that limits the duty of a
gain before a motor's back-EMF, so the command is the duty.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rlco.gap.compare.servo.plant import SERVO_NUMBERS, fitted_servo
from rlco.gap.compare.verdict import Verdict
from rlco.gap.correct.corrected_files import (
    corrected_xml,
    rounded,
    with_notes,
    write_files,
)
from rlco.gap.model import LoadedModel
from rlco.gap.servo_models import Pendulum, Servo, pendulum_xml
from rlco.physics.effects import AppliedEffect

#: What the files beside a servo's report are.
SERVO_FILES = {
    "model.xml": "the servo on its pendulum, its own numbers as fitted; the command is "
    "the duty, and comments at its top say what no MJCF holds",
    "effects.yaml": "the named effects; for make_env, say in its names what the "
    "servo's joint is called in your robot",
}


def write_servo(loaded: LoadedModel, verdict: Verdict, out: str | Path) -> list[Path]:
    """Write ``model.xml``, ``model.diff`` and ``effects.yaml`` of a servo.

    Args:
        loaded: The servo with its published numbers, and a pendulum.
        verdict: What was found, the servo's own numbers among its effects.
        out: An existing folder.

    Returns:
        The three files.

    Raises:
        ValueError: The model is no servo.
    """
    if loaded.servo is None or loaded.pendulum is None:
        raise ValueError(f"model {loaded.name!r} is no servo on a pendulum")
    servo, zero = fitted_servo(loaded.servo, verdict.hypothesis.effects)
    effects = [
        rounded(one) for one in verdict.hypothesis.effects if one.name != SERVO_NUMBERS
    ]
    # On the bench a gain is the firmware's, which acts before the duty is limited.
    in_model = [one for one in effects if one.name != "actuator_gain"]
    source = pendulum_xml(servo, loaded.pendulum, zero=zero)
    text = corrected_xml(replace(loaded, source=source), in_model, out)
    notes = _notes(servo, loaded.pendulum, effects)
    return write_files(loaded, with_notes(text, notes), effects, out)


def _notes(servo: Servo, pendulum: Pendulum, effects: list[AppliedEffect]) -> list[str]:
    notes = [
        "not in this file: the firmware, which makes the command of each step, "
        f"duty = {servo.duty_gain:.6g} kp (goal - position), within -1 and 1",
        f"torque constant {servo.torque_constant:g} N m/A and resistance "
        f"{servo.resistance:g} ohm give the actuator's numbers at {pendulum.volts:g} V",
    ]
    for effect in effects:
        if effect.name == "actuator_gain":
            factor = effect.parameters["factor"]
            notes.append(
                "not in this file but in effects.yaml: actuator_gain, the firmware's "
                f"kp times {factor:g}"
            )
    return notes
