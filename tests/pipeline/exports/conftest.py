"""Arms with every effect that bodies and drives can have, at sizes drawn at random."""

import numpy as np
import pinocchio as pin
import pytest

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE


def with_effects(model, names, seed=0):
    rng = np.random.default_rng(seed)
    for name in names:
        effect = CATALOGUE[name]
        if model.joints_effect_can_act_on(effect):
            model = model.with_effect(effect)
    values = {
        name: float(np.clip(p.value + rng.uniform(0.3, 0.8) * p.typical, p.lower, p.upper))
        for name, p in model.parameters.items()
    }
    return model.with_values(values)


@pytest.fixture(scope="session", params=["baxter", "ur5"])
def bare_arm(request):
    return arm_model(robot=request.param)


def states(model, count=200, seed=1):
    """Positions inside the limits, speeds well away from zero, accelerations; (count, n) each."""
    rng, limits, n = np.random.default_rng(seed), model.arm.robot.limits, len(model.joints)
    q = rng.uniform(np.maximum(limits.lower, -3.0) + 0.02, np.minimum(limits.upper, 3.0) - 0.02, (count, n))
    v = rng.choice([-1.0, 1.0], (count, n)) * rng.uniform(0.3, 2.0, (count, n))
    return q, v, rng.normal(0.0, 2.0, (count, n))


def by_formulas(model, *states):
    """(m, n) torques by Pinocchio with the model's links and gravity, and the formulas of the effects in numpy."""
    bodies = model.arm.model.copy()
    for i, link in enumerate(model.link_parameters().values()):
        bodies.inertias[i + 1] = pin.Inertia.FromDynamicParameters(link)
    bodies.gravity = pin.Motion(np.concatenate([model.gravity(), np.zeros(3)]))
    own, (q, v, a) = bodies.createData(), (np.atleast_2d(x) for x in states)
    load = np.array([pin.rnea(bodies, own, *state) for state in zip(q, v, a, strict=True)])

    def of(name):
        """(n,) a parameter by joint; 0 where the model has none."""
        found = (model.parameters.get(f"{name}[{joint}]") for joint in model.joints)
        return np.array([0.0 if parameter is None else parameter.value for parameter in found])

    sign, way = (
        np.sign(v),
        np.where(v > 0, of("joint_asymmetric_friction.positive"), of("joint_asymmetric_friction.negative")),
    )
    tau = load + of("joint_viscous_friction.coefficient") * v + (of("joint_coulomb_friction.torque") + way) * sign
    falls, speed = (of(f"joint_stribeck_friction.{name}") for name in ("torque", "speed"))
    tau += falls * sign * np.exp(-((v / np.where(falls, speed, 1.0)) ** 2))
    tau += of("joint_load_friction.coefficient") * np.abs(load) * sign + of("rotor_inertia.inertia") * a
    tau += of("gravity_spring.sine") * np.sin(q) + of("gravity_spring.cosine") * np.cos(q)
    tau += of("joint_spring.stiffness") * (q - of("joint_spring.rest"))
    viscous, inertia = of("joint_coupling.viscous")[1:], of("joint_coupling.inertia")[1:]
    tau[:, 1:] += viscous * v[:, :-1] + inertia * a[:, :-1]
    tau[:, :-1] += viscous * v[:, 1:] + inertia * a[:, 1:]
    return tau
