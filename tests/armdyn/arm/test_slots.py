"""Slots of simulators that effects fill: read from equations, and checked against what the effects compute."""

from collections import Counter
from dataclasses import fields

import casadi as ca
import numpy as np
import pytest

from armdyn.arm import slots as known
from armdyn.arm.physics import DriveCommands, Joint, Link, Neighbour
from armdyn.arm.slots import slots_of
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

OF_ARMS = [one for one in CATALOGUE.values() if one.acts_on in ("joint", "drive") and one.reach != "base"]


def computed(one, values, q, v, a):
    """Torque, gain, offset by what was told and delay of an effect at a state, with the sign of the velocity."""
    told = DriveCommands(**{f.name: ca.SX.sym(f.name) for f in fields(DriveCommands)})
    place = [ca.SX.sym(name) for name in ("time", "q", "v", "a", "way", "load")]
    joint = Joint(
        *place, Neighbour(*(ca.SX.sym(f"inner_{n}") for n in "qva")), Link(ca.SX.eye(4), ca.SX(4, 4)), told=told
    )
    after = one.apply(joint, {f"{one.name}.{short}": ca.SX(value) for short, value in values.items()})
    outputs = [after.torque, after.gain, after.offset, after.delay]
    inputs = [*place, *(getattr(told, f.name) for f in fields(DriveCommands))]
    found = ca.Function("f", inputs, outputs)(0.3, q, v, a, np.sign(v), 7.0, 3.0, 2.0, 5.0, 0.4, 0.1)
    return [float(part) for part in found]


@pytest.mark.parametrize(
    "one", [e for e in OF_ARMS if slots_of(e).names - {known.LINK, known.PLAY}], ids=lambda e: e.name
)
def test_slots_together_are_what_the_effect_computes(one):
    random = np.random.default_rng(0)
    for _ in range(20):
        values = {short: float(random.uniform(0.2, 1.5)) for short in one.quantities}
        q, v, a = random.uniform(-2.0, 2.0, 3)
        s = Counter({known.GAIN: 1.0} | slots_of(one).at([*values.values()]))
        torque = s[known.DAMPING] * v + s[known.FRICTION] * np.sign(v) + s[known.ARMATURE] * a + s[known.TORQUE]
        torque += (
            s[known.STIFFNESS] * q + s[known.REST_TORQUE] + s[known.SINE] * np.sin(q) + s[known.COSINE] * np.cos(q)
        )
        if s[known.FADING_FRICTION]:
            torque += s[known.FADING_FRICTION] * np.sign(v) * np.exp(-((v / s[known.FADING_SPEED]) ** 2))
        offset = s[known.OFFSET] + s[known.DRIVE_DAMPING] * v + s[known.VELOCITY_COMMAND] * 0.4
        offset += s[known.COMMAND_DELAY] * 2.0
        expected = [torque, s[known.GAIN], offset, s[known.READING_DELAY]]
        assert computed(one, values, q, v, a) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("one", [e for e in OF_ARMS if not slots_of(e).names], ids=lambda e: e.name)
def test_an_effect_without_slots_says_on_what_it_depends(one):
    assert slots_of(one).depends_on
    assert slots_of(one).at([1.0] * len(one.quantities)) == {}


def test_an_effect_of_ones_own_has_the_slots_of_its_equation_whatever_its_name():
    @effect(summary="Grease and dirt.", source="a test")
    def grease(joint: Joint, thick=quantity("N m s/rad", typical=1.0), dry=quantity("N m", typical=1.0)) -> Joint:
        """tau = c v + f sign(v)."""
        return joint.with_torque(2 * thick * joint.velocity + dry * joint.direction)

    @effect(summary="Grease that thins.", source="a test")
    def thin_grease(joint: Joint, thick=quantity("N m s/rad", typical=1.0)) -> Joint:
        """tau = c v |v|."""
        return joint.with_torque(thick * joint.velocity * ca.fabs(joint.velocity))

    assert slots_of(grease).at([0.5, 3.0]) == {known.DAMPING: 1.0, known.FRICTION: 3.0}
    assert not slots_of(thin_grease).names
    assert known.DAMPING in slots_of(thin_grease).depends_on
