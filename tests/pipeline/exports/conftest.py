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
        if model.possible_joints(effect):
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


def by_formulas(model, q, v, a):
    """(n,) torques by Pinocchio with the model's links and gravity, and the formulas of the effects in numpy."""
    bodies = model.arm.model.copy()
    for i, link in enumerate(model.link_parameters().values()):
        bodies.inertias[i + 1] = pin.Inertia.FromDynamicParameters(link)
    bodies.gravity = pin.Motion(np.concatenate([model.gravity(), np.zeros(3)]))
    load = pin.rnea(bodies, bodies.createData(), q, v, a)
    tau = load.copy()
    for i, joint in enumerate(model.joints):

        def of(name, joint=joint):
            parameter = model.parameters.get(f"{name}[{joint}]")
            return parameter.value if parameter is not None else 0.0

        sign = np.sign(v[i])
        tau[i] += of("joint_viscous_friction.coefficient") * v[i] + of("joint_coulomb_friction.torque") * sign
        tau[i] += of("joint_asymmetric_friction.positive" if sign > 0 else "joint_asymmetric_friction.negative") * sign
        if of("joint_stribeck_friction.torque"):
            fading = np.exp(-((v[i] / of("joint_stribeck_friction.speed")) ** 2))
            tau[i] += of("joint_stribeck_friction.torque") * sign * fading
        tau[i] += of("joint_load_friction.coefficient") * abs(load[i]) * sign + of("rotor_inertia.inertia") * a[i]
        tau[i] += of("gravity_spring.sine") * np.sin(q[i]) + of("gravity_spring.cosine") * np.cos(q[i])
        tau[i] += of("joint_spring.stiffness") * (q[i] - of("joint_spring.rest"))
        viscous, inertia = of("joint_coupling.viscous"), of("joint_coupling.inertia")
        if i:
            tau[i] += viscous * v[i - 1] + inertia * a[i - 1]
            tau[i - 1] += viscous * v[i] + inertia * a[i]
    return tau
