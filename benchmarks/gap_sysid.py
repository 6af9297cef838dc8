"""mujoco.sysid on the same cases: given the right effects, and with the usual list.

- `oracle`: its optimiser, given which effects act and where, finds their numbers from
  half the truth. Times of whole steps, which leave it no slope, are told.
- `pace`: its own pipeline with what most people fit (as PACE does: armature, damping,
  friction and encoder bias of every joint, one delay).

    python benchmarks/gap_sysid.py CASE_FOLDER

prints what each leaves of the held-out recordings, as one line of JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import mujoco.sysid as sysid
import numpy as np
from gap_arms import Array
from gap_baselines import Logged, hidden_of, left, read_case, residual, split
from gap_plant import Hidden

# What the usual list holds; an effect outside it is what a longer library is for.
_NUMBERS = {
    "armature": "armature",
    "viscous_damping": "damping",
    "coulomb_friction": "frictionloss",
    "joint_offset": "offset",
}
PACE = (*_NUMBERS, "command_delay")
# Of these the plant knows whole steps only: no slope to follow.
_TOLD = ("command_delay", "control_rate")


def oracle(logged: Logged, truth: Sequence[Hidden]) -> tuple[Hidden, ...]:
    """Return the right effects with the numbers that mujoco.sysid's optimiser finds.

    Args:
        logged: The case.
        truth: What acts.
    """
    train, _ = split(len(logged.positions))
    parameters = sysid.ParameterDict()
    for effect in truth:
        if effect.name in _TOLD:
            continue
        for name, value in effect.parameters.items():
            neutral = 1.0 if name == "factor" else 0.0
            away = value - neutral
            # Limits are approached from where they never act, all else from nothing.
            start = 1.5 * value if name == "limit" else neutral + 0.5 * away
            ends = sorted((neutral + 0.02 * away, neutral + 4.0 * away))
            if effect.name == "payload" and name in "xyz":
                start, ends = 0.0, [-0.3, 0.3]
            key = f"{effect.name} {effect.target} {name}"
            parameters.add(sysid.Parameter(key, start, ends[0], ends[1]))
    if parameters.size == 0:
        return tuple(truth)

    def effects_at(values: Array) -> list[Hidden]:
        found = dict(zip(parameters.keys(), values.tolist(), strict=True))
        return [
            Hidden(
                effect.name,
                effect.target,
                {
                    name: found.get(f"{effect.name} {effect.target} {name}", value)
                    for name, value in effect.parameters.items()
                },
            )
            for effect in truth
        ]

    def misfit(values: Array, _: sysid.ParameterDict) -> Any:
        columns = np.reshape(values, (parameters.size, -1)).T
        rows = [residual(logged, effects_at(column), train) for column in columns]
        found = np.stack(rows, axis=1) if np.ndim(values) > 1 else rows[0]
        return [found], None, None

    best, _ = sysid.optimize(
        parameters,
        misfit,
        optimizer="scipy",
        verbose=False,
        diff_step=1e-3,
        max_iters=12,
    )
    return tuple(effects_at(best.as_vector()))


def pace(logged: Logged) -> tuple[Hidden, ...]:
    """Return what mujoco.sysid's own pipeline makes of the usual list."""
    spec = mujoco.MjSpec.from_string(logged.xml)
    model = spec.compile()
    joints = [model.joint(number).name for number in range(model.njnt)]
    parameters = _pace_parameters(model, joints)
    misfit = sysid.build_residual_fn(
        models_sequences=[_sequences(logged, spec, model, joints)],
        build_model=lambda values, base: _pace_model(values, base, joints),
        custom_rollout=_late_rollout,
        modify_residual=_biased(joints),
        n_threads=1,
    )
    best, _ = sysid.optimize(parameters, misfit, verbose=False, max_iters=15, eps=1e-5)
    found = dict(zip(best.keys(), best.as_vector().tolist(), strict=True))
    effects = [Hidden("command_delay", None, {"delay": found["delay"]})]
    for joint in joints:
        effects += [
            Hidden(name, joint, {number: found[f"{joint} {number}"]})
            for name, number in _NUMBERS.items()
        ]
    return tuple(effects)


def _pace_parameters(
    model: mujoco.MjModel, joints: Sequence[str]
) -> sysid.ParameterDict:
    parameters = sysid.ParameterDict()
    for joint in joints:
        dof = model.joint(joint).dofadr[0]
        here = {
            "armature": float(model.dof_armature[dof]),
            "damping": float(model.dof_damping[dof]),
        }
        for number, present in here.items():
            key, low = f"{joint} {number}", -0.95 * present
            parameters.add(sysid.Parameter(key, 0.0, low, 50.0 * max(present, 0.01)))
        # From zero its optimiser does not get away.
        friction = 0.05 * max(here["damping"], 0.01)
        parameters.add(sysid.Parameter(f"{joint} frictionloss", friction, 0.0, 100.0))
        parameters.add(sysid.Parameter(f"{joint} offset", 0.0, -0.2, 0.2))
    parameters.add(sysid.Parameter("delay", 0.01, 0.0, 0.2))
    return parameters


def _pace_model(
    values: sysid.ParameterDict, base: mujoco.MjSpec, joints: Sequence[str]
) -> mujoco.MjModel:
    model = base.compile()
    for joint in joints:
        dof, servo = model.joint(joint).dofadr[0], model.actuator(joint).id
        model.dof_armature[dof] += values[f"{joint} armature"].value[0]
        model.dof_damping[dof] += values[f"{joint} damping"].value[0]
        model.dof_frictionloss[dof] += values[f"{joint} frictionloss"].value[0]
        # The servo pulls what its encoder tells.
        stiffness = model.actuator_biasprm[servo, 1]
        bias = values[f"{joint} offset"].value[0]
        model.actuator_biasprm[servo, 0] += stiffness * bias
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _sequences(
    logged: Logged,
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    joints: Sequence[str],
) -> sysid.ModelSequences:
    train, _ = split(len(logged.positions))
    states, controls, measured = [], [], []
    clock = model.opt.timestep
    for number in train:
        told, sent = logged.positions[number], logged.commands[number]
        frames = np.arange(len(told)) / logged.fps
        # Held commands: sysid would draw straight lines between frames.
        fine = np.arange(round(frames[-1] / clock) + 1) * clock
        held = sent[np.minimum((fine * logged.fps + 1e-6).astype(int), len(sent) - 1)]
        states.append(sysid.create_initial_state(model, told[0]))
        controls.append(sysid.TimeSeries.from_control_names(fine, held, model))
        names = [(f"{joint}", sysid.SignalType.MjStateQPos) for joint in joints]
        measured.append(sysid.TimeSeries.from_names(frames, told, model, names))
    episodes = [f"episode {number}" for number in train]
    return sysid.ModelSequences(
        "arm", spec, episodes, states, controls, measured, allow_missing_sensors=True
    )


def _late_rollout(**given: Any) -> Any:
    """Shift the commands by the delay, then roll out as mujoco.sysid does."""
    values, signals = given.pop("param_dicts"), given["control_signal"]
    each = len(signals) // len(values)
    late = []
    for number, signal in enumerate(signals):
        delay = values[number // each]["delay"].value[0]
        times = signal.times - delay
        data = np.stack(
            [np.interp(times, signal.times, line) for line in signal.data.T], axis=1
        )
        late.append(sysid.TimeSeries(signal.times, data, signal.signal_mapping))
    return sysid.sysid_rollout(**(given | {"control_signal": late}))


def _biased(joints: Sequence[str]) -> Any:
    """Return a residual of positions as biased encoders tell them."""

    def misfit(
        values: sysid.ParameterDict,
        predicted: sysid.TimeSeries,
        measured: sysid.TimeSeries,
        model: mujoco.MjModel,
        return_pred_all: bool,
        *,
        state: Array,
        sensor_weights: Mapping[str, float] | None = None,
    ) -> Any:
        offsets = [values[f"{joint} offset"].value[0] for joint in joints]
        told = state[:, 1 : 1 + model.nq] + np.array(offsets)
        inside = measured.times <= state[-1, 0]
        times = measured.times[inside]
        lines = [np.interp(times, state[:, 0], line) for line in told.T]
        data, mapping = np.stack(lines, axis=1), measured.signal_mapping
        aim = sysid.TimeSeries(times, measured.data[inside], mapping)
        return data - aim.data, sysid.TimeSeries(times, data, mapping), aim

    return misfit


def compare_sysid(folder: Path) -> dict[str, Any]:
    """Return what both fits of mujoco.sysid leave of a case, and the truth itself."""
    truth = json.loads((folder / "truth.json").read_text())
    logged, effects = read_case(folder), hidden_of(truth["effects"])
    _, held = split(len(logged.positions))
    out: dict[str, Any] = {
        "name": folder.name,
        "nothing": left(logged, (), held),
        "truth": left(logged, effects, held),
    }
    fits = {"oracle": lambda: oracle(logged, effects)}
    if not {effect.name for effect in effects} <= set(PACE):
        fits["pace"] = lambda: pace(logged)
    for name, fitted in fits.items():
        began = time.perf_counter()
        found = fitted()
        out[f"{name}_seconds"] = round(time.perf_counter() - began, 1)
        out[name] = left(logged, found, held)
    return out


if __name__ == "__main__":
    print(json.dumps(compare_sysid(Path(sys.argv[1]))))
