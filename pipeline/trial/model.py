"""The model that the robot starts a trial with: what is known of load and load cell before it moves."""

from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.model import PendulumModel, pendulum_model
from pipeline.trial.settings import TrialSettings

NUISANCES: dict[str, tuple[str, float, float]] = {
    "linear_drag": ("linear_drag.coefficient", 0.0, 0.01),
    "sensor_bias": ("sensor_bias.force", 0.0, 0.02),
    "sensor_delay": ("sensor_delay.time", 0.01, 0.01),
}
"""Effects that every estimate of the length must allow for: parameter, prior mean and standard deviation.

Ignoring them costs millimetres: 0.25 mm per ms of delay, 1 mm per 0.01 N of bias, 1 mm per 1 % of mass.
"""

UPRIGHT, LEAN = 1e-3, 0.05
"""rad; a load that hangs askew by more than the first does so with an uncertainty of the second."""


def trial_model(settings: TrialSettings) -> PendulumModel:
    """The given model, or the bare pendulum, with the nuisances, the weighed mass and the guessed length.

    The effects of a given model keep their values; what was fitted there becomes a prior, and stays fixed where no
    standard deviation is known.
    """
    given = settings.model or pendulum_model(settings.length_guess, settings.mass)
    model = given
    for effect in given.effects:
        for p in effect.parameters():
            known = given.parameters[p.name]
            model = model.with_prior(p.name, known.value, known.std) if known.std else model.with_fixed(p.name)
    for name, (parameter, mean, std) in NUISANCES.items():
        if all(effect.name != name for effect in given.effects):
            model = model.with_effect(CATALOGUE[name]).with_prior(parameter, mean, std)
    model = model.with_prior("mass", settings.mass, settings.mass_std)
    model = model.with_values({"length": settings.length_guess})
    rest = model.rest_angle()
    # The load hangs at rest at first; where an effect pulls it aside, how far is as uncertain as the effect.
    model = model.with_values({"initial_angle": rest, "initial_rate": 0.0}).with_fixed("initial_rate")
    return model.with_prior("initial_angle", rest, LEAN) if abs(rest) > UPRIGHT else model.with_fixed("initial_angle")
