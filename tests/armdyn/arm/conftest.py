from pathlib import Path

import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.estimation.descent import DescentSettings, descend
from armdyn.identify.estimator import estimate

JOINT_EFFECTS = tuple(name for name, effect in CATALOGUE.items() if effect.acts_on == "joint" and not effect.needs)
RECORDINGS = Path(__file__).parents[4] / "shared" / "data"


@pytest.fixture(scope="session")
def baxter():
    return arm_model(robot="baxter")


def with_effects(model, **values):
    """The model with effects on all joints; a value is called ``effect__quantity``."""
    for name in dict.fromkeys(quantity.partition("__")[0] for quantity in values):
        model = model.with_effect(find(name))
    named = {q.replace("__", "."): value for q, value in values.items()}
    return model.with_values({f"{q}[{joint}]": value for q, value in named.items() for joint in model.joints})


def fitted(model, runs, noise=None, **settings):
    """The model at the least-squares estimate from prepared runs, and the estimate."""
    noise = noise or {c: float(np.mean([r.noise[c] for r in runs])) for c in model.predicted_channels(runs[0])}
    found = estimate(model, runs, noise, lambda cost, start: descend(cost, start, DescentSettings(**settings)))
    return model.with_values(dict(zip(found.names, found.values, strict=True))), found


def residuals(model, run):
    """Measured minus predicted by channel."""
    prediction = model.predict(run, model.theta())
    return {name: run.channels[name].value - prediction.values[rows] for name, rows in prediction.slices.items()}


def chi2_per_sample(model, run):
    """Of all channels together, with the run's own noise."""
    scaled = [r / run.noise[name] for name, r in residuals(model, run).items()]
    return float(np.mean(np.concatenate(scaled) ** 2))


def total_rmse(model, run):
    """Root of the sum over the joints of the squared RMSE."""
    return float(np.sqrt(sum(np.mean(r**2) for r in residuals(model, run).values())))
