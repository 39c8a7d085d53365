import numpy as np
import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.experiments.gripper import motion_series
from armdyn.experiments.hypothesis import Experiment, Hypothesis, Motion, PredictedExperiment
from armdyn.parameter import column, quantity
from armdyn.pendulum.model import pendulum_model


@effect(summary="", source="")
def oil(string, k=quantity("N m s/(rad K)", typical=1e-5), warm=column("extra.temperature", "K", usual=290.0)):
    return string.with_torque(-k * string.rate * warm)


EFFECTS = {**CATALOGUE, "oil": oil}
SERIES = motion_series(3.0)
BASIS = SERIES.at(np.linspace(0.0, 3.0, 151))
COEFFICIENTS = 0.02 * np.random.default_rng(0).standard_normal(SERIES.size)


def motion(coefficients):
    moved = BASIS.motion(coefficients[None])
    return Motion(BASIS.time, np.hstack([moved.q, moved.v, moved.a]).T)


def predicted(effects, coefficients, noise):
    """A hypothesis with effects at their typical sizes, in an experiment with one motion."""
    model = pendulum_model(0.368, 0.08, [EFFECTS[name] for name in effects])
    model = model.with_values({n: p.typical for n, p in model.parameters.items() if p.effect})
    free = ("length", "mass")
    experiment = Experiment("motion", "", motion(coefficients), noise)
    return PredictedExperiment(Hypothesis("", model, free, np.zeros((2, 2))), experiment)


# Plain equations; the sensor's lag and delay; a gripper that trails; what yields, with its jerk and impulse; further
# states; a column of recordings, alone and behind what yields and trails.
@pytest.mark.parametrize(
    "effects",
    [
        ("linear_drag",),
        ("sensor_lag", "sensor_delay"),
        ("gripper_lag", "pivot_coulomb_friction"),
        ("string_elasticity", "sensor_lag"),
        ("gripper_compliance", "gripper_lag"),
        ("out_of_plane_swing", "wind"),
        ("oil",),
        ("oil", "gripper_compliance", "gripper_lag"),
    ],
)
def test_the_reverse_pass_gives_the_gradient_of_any_sum_of_readings(effects):
    noise = {"load_force": 5e-3, "swing_angle": 5e-3}
    at = predicted(effects, COEFFICIENTS, noise)
    rng = np.random.default_rng(1)
    readings, swing = rng.normal(size=len(at.predict(at.start)[0])), rng.normal(size=len(BASIS.time))
    gradient = at.by_coefficients(at.start, BASIS, readings, swing)

    def total(coefficients):
        other = predicted(effects, coefficients, noise)
        return readings @ other.predict(other.start)[0] + swing @ other.swing(other.start)

    some = rng.choice(SERIES.size, 4, replace=False)
    steps = 1e-4 * np.eye(SERIES.size)[some]
    numeric = [(total(COEFFICIENTS + s) - total(COEFFICIENTS - s)) / 2e-4 for s in steps]
    np.testing.assert_allclose(numeric, gradient[some], rtol=0, atol=1e-6 * np.abs(gradient).max())
