"""What a model computes, as CasADi functions that need no parameters any more; for C and Python."""

from dataclasses import dataclass

import casadi as ca

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.variational import STATE_SIZE
from pipeline.exports.parts import SENSOR, left_over

PENDULUM_SENSOR = "sensor"


@dataclass(frozen=True)
class Function:
    """One function for other languages.

    Attributes:
        function: all inputs and outputs are vectors or numbers.
        summary: what it computes, in a line.
        inputs: by name, what it is and its unit.
        outputs: likewise.
    """

    function: ca.Function
    summary: str
    inputs: dict[str, str]
    outputs: dict[str, str]


def functions_of(model: Model) -> tuple[list[Function], list[str]]:
    """The functions of a model, and sentences on what they leave out.

    Raises:
        InputError: a base of a user's own, or an effect that no function of one instant has.
    """
    if isinstance(model, ArmModel):
        return _of_arm(model)
    if isinstance(model, PendulumModel):
        return _of_pendulum(model)
    raise InputError(
        f"a model of base '{model.base}' has no function for other languages: export its parameters, --output FILE.json"
    )


def _of_arm(model: ArmModel) -> tuple[list[Function], list[str]]:
    from armdyn.arm.symbolic import inverse_dynamics_function

    per = ", ".join(f"{name} [{'m' if s else 'rad'}]" for name, s in zip(model.joints, model.arm.slides, strict=True))
    found = Function(
        inverse_dynamics_function(model),
        "Torques that the drives give during a motion; dry friction has the sign of v.",
        {"q": f"positions: {per}", "v": "velocities, per s", "a": "accelerations, per s^2"},
        {"tau": "torques, N m (forces, N, of joints that slide)"},
    )
    held = {effect.name for effect in model.effects} - SENSOR
    return [found], left_over(model, held, "a function", symmetric=False)


def _of_pendulum(model: PendulumModel) -> tuple[list[Function], list[str]]:
    variational = model.variational()
    theta = ca.DM([model.parameters[name].value for name in variational.names])
    s, u, t, dt = ca.SX.sym("s", STATE_SIZE), ca.SX.sym("u"), ca.SX.sym("t"), ca.SX.sym("dt")
    following = variational.step(s, u, t, dt, theta)
    tension = variational.tension(s, u, t, dt, theta, following)
    names = ["s", "u", "t", "dt"], ["s_next", "tension"]
    step = ca.Function("step", [s, u, t, dt], [ca.densify(following), ca.densify(tension)], *names)
    found = Function(
        step,
        "One step of the midpoint variational integrator.",
        {
            "s": "gripper position [m], its velocity over the last step [m/s], swing angle [rad], its rate likewise "
            "[rad/s]",
            "u": "acceleration of the gripper [m/s^2]",
            "t": "time of s [s]",
            "dt": "length of the step [s]",
        },
        {"s_next": "the state after the step", "tension": "of the string at s [N]"},
    )
    notes = []
    for effect in model.effects:
        if effect.acts_on == PENDULUM_SENSOR:
            notes.append(f"{effect.name}: belongs to the sensor, not to the pendulum")
        elif effect.name in ("gripper_lag", "out_of_plane_swing"):
            notes.append(f"{effect.name}: a step along the line of motion leaves it out")
    return [found], notes
