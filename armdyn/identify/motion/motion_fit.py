r"""Fit the values of an arm's model to its motion, where the recordings contain the drives' commands but no torques.

Which effects are missing is found by linear least squares on the torques that follow from the drives' control laws. The
friction found in this way is too small by a quarter to a half, because samples of a sticking joint are left out. So the
values of the effects, the gains and the delays are finally fitted by least squares to the positions of a closed-loop
simulation. The windows of the simulation grow from short pieces of the measured motion to whole recordings (multiple
shooting first: Bock 1983), because over a whole recording with a wrong start the gradient is useless.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.arm.closed_loop.rollout import (
    MAX_COARSE_ROLLOUT_STEP_SECONDS,
    MAX_ROLLOUT_STEP_SECONDS,
    can_simulate_motion,
    has_all_position_commands,
)
from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.identify.motion.motion_cost import CLOSED_LOOP_WINDOW_SECONDS, OPEN_LOOP_WINDOW_SECONDS, MotionCost
from armdyn.identify.motion.motion_unknowns import OF_EFFECTS, model_at, motion_unknowns, value_of_unknown
from armdyn.run import Run


def fit_to_motion(model: ArmModel, runs: Sequence[Run], given: Mapping[str, Servo] | None = None) -> ArmModel:
    """Fit an arm's model to the measured positions of runs by closed-loop simulation, and return it.

    A model without drives, or runs without commands, leave the model unchanged.

    Args:
        model: the model with its effects.
        runs: training runs.
        given: the drives as the user declared them, whose stated gains are priors; None means those of the model.
    """
    usable = [run for run in runs if model.drives and can_simulate_motion(model, run)]
    if not usable:
        return model
    lengths = (
        CLOSED_LOOP_WINDOW_SECONDS
        if all(has_all_position_commands(model, run) for run in usable)
        else OPEN_LOOP_WINDOW_SECONDS
    )
    seen = _seen_by_sensors(model, usable)
    unknowns = [u for u in motion_unknowns(model, model.drives if given is None else given) if u.name not in seen]
    values = np.array([value_of_unknown(model, unknown) for unknown in unknowns])
    spread = np.zeros(len(values))
    for length, step in (
        *((length, MAX_COARSE_ROLLOUT_STEP_SECONDS) for length in lengths),
        (lengths[-1], MAX_ROLLOUT_STEP_SECONDS),
    ):
        values, spread = MotionCost(model, usable, unknowns, length, step).fitted(values)
    moved = model_at(model, unknowns, values)
    told = {u.name: std for u, std in zip(unknowns, spread.tolist(), strict=True) if u.of in OF_EFFECTS and std > 0.0}
    return moved.with_parameters({n: replace(moved.parameters[n], std=std) for n, std in told.items()})


def _seen_by_sensors(model: ArmModel, runs: Sequence[Run]) -> set[str]:
    """Names of the parameters on which a recorded wrench depends, which keep the values of the fit to it.

    A motion says less of a tool, and nothing of what a sensor reads.
    """
    found = set[str]()
    for run in runs:
        if any(sensor.recorded(run) for sensor in model.sensors.values()):
            wrenches = model.without_predictions(run, [name for name in run.channels if name.startswith("tau.")])
            derivatives = model.predict(model.prepare_run(wrenches), model.theta()).sensitivities
            found |= {name for name, of in zip(model.names, derivatives.T, strict=True) if of.any()}
    return found
