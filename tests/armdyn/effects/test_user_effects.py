from pathlib import Path

import numpy as np

from armdyn.effects.effect import effect
from armdyn.effects.user import load_effects
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

EXAMPLE = Path(__file__).parents[3] / "examples/my_effects.py"


def test_the_documented_example_simulates_and_has_derivatives():
    (magnet,) = load_effects(EXAMPLE)
    model = pendulum_model(0.368, 0.08, [magnet]).with_values({"initial_angle": 0.2})
    t = np.arange(0.0, 1.0, 0.01)
    run = Run("a.csv", {"load_force": Channel(t, 0 * t, "N")})
    prediction = model.predict(run, model.theta())
    column = prediction.sensitivities[:, model.names.index("magnet.strength")]
    assert np.max(np.abs(column)) > 0.1


def test_name_and_stage_are_those_of_the_function_where_they_are_not_given():
    @effect(summary="a spring across the hinge", source="Hooke 1678")
    def hinge_spring(string, stiffness=quantity("N m/rad", typical=0.01)):
        return string.with_torque(-stiffness * string.angle)

    @effect("slow", "sensor", summary="", source="")
    def named_otherwise(it, time=quantity("s", typical=0.01)):
        return it.with_lag(time)

    assert (hinge_spring.name, hinge_spring.acts_on) == ("hinge_spring", "string")
    assert (named_otherwise.name, named_otherwise.acts_on) == ("slow", "sensor")
    names = pendulum_model(0.3, 0.1, [hinge_spring, named_otherwise]).names
    assert names[-2:] == ("hinge_spring.stiffness", "slow.time")
