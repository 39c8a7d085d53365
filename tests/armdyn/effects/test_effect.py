"""An effect on the same joints is the same effect: what is derived of it is found again."""

from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.model import pendulum_model


def test_an_effect_on_joints_is_made_once():
    spring = CATALOGUE["gravity_spring"]
    elbow = spring.on("elbow")
    assert elbow is spring.on("elbow")
    assert elbow is not spring
    assert elbow.on() is spring.on() is spring
    assert elbow.on("elbow", "wrist") is spring.on("elbow", "wrist")


def test_two_models_alike_share_what_was_derived():
    one, other = (pendulum_model(0.4, 0.08).with_effect(CATALOGUE["linear_drag"]) for _ in range(2))
    assert one.system is other.system
