"""A simulated arm at work: rigid bodies, dry friction and coloured noise; and what may happen to it."""

import numpy as np
from worlds import coloured

from armdyn.arm.model import arm_model
from armdyn.arm.rigid import inverse_dynamics
from armdyn.effects.catalogue import CATALOGUE

FRICTION, NOISE, RATE = 2.0, 0.15, 250.0


def model():
    """A UR5 with dry friction in every joint."""
    arm = arm_model(robot="ur5").with_effect(CATALOGUE["joint_coulomb_friction"])
    return arm.with_values({name: FRICTION for name in arm.names if "coulomb" in name})


def work(arm, seed, seconds=60.0, *, load=0.0, friction=1.0, begin=0.0, outside=None, until=np.inf):
    """(time, q, tau) of random motion; from `begin` on a load, kg, friction times a factor or a torque from outside."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    w = 2 * np.pi * rng.uniform(0.05, 0.35, (4, 6))
    size, phase = rng.uniform(0.1, 0.3, (4, 6)), rng.uniform(0, 2 * np.pi, (4, 6))
    angle = w * time[:, None, None] + phase
    q, v, a = (
        (size * w**k * trig).sum(axis=1) for k, trig in ((0, np.sin(angle)), (1, np.cos(angle)), (2, -np.sin(angle)))
    )
    q = q + np.array([0.0, -1.2, 1.2, 0.0, 0.5, 0.0])
    after = (time >= begin) & (time < until)
    tau = inverse_dynamics(arm.arm.model, q, v, a)
    if load:
        heavier = arm.arm.model.copy()
        parameters = arm.arm.described[-1].copy()
        parameters[0] += load
        heavier.inertias[6] = heavier.inertias[6].FromDynamicParameters(parameters)
        tau[after] = inverse_dynamics(heavier, q, v, a)[after]
    own = np.full(tau.shape, FRICTION)
    own[after, 1] *= friction
    tau += own * np.sign(v)
    noise = rng.standard_normal(tau.shape)
    slow = coloured(noise, np.exp(-1 / (0.5 * RATE)))  # the model's own error: new every half a second
    tau += NOISE * slow + 0.05 * rng.standard_normal(tau.shape)
    if outside is not None:
        tau[after] += outside
    return time, q, tau


def samples(recording, later=0.0):
    time, q, tau = recording
    yield from zip((time + later).tolist(), q, tau, strict=True)
