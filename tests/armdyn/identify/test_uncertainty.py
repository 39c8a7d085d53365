"""Standard deviations count the model's own error in where it is larger than the noise, and only there."""

import numpy as np
import pytest
from hidden_effects.arm import generate, true_parameters

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.identify.noise import variance_inflation
from armdyn.identify.study import Study
from armdyn.identify.uncertainty import uncertainty, whitened_covariance


def errors(hidden, extra, seed):
    """Errors of the fitted values over standard deviations: those of least squares in whitened noise, and ours."""
    runs = [generate((hidden, *extra), 1.0, seed, recording=k) for k in range(2)]
    study = Study(arm_model(robot="baxter").with_effect(find(hidden)), runs, [], [])
    fit = study.first()
    true = true_parameters(hidden, 1.0)
    wrong = np.array([fit.values[i] - true[fit.problem.columns[i].name] for i in np.flatnonzero(fit.free)])
    known = uncertainty(study, fit)
    covariances = whitened_covariance(fit), known.covariance
    return known, *(np.abs(wrong) / np.sqrt(np.diag(c)[fit.free]) for c in covariances)


def test_noise_alone_changes_no_interval():
    known, whitened, ours = errors("rotor_inertia", (), 0)
    assert known.widened == 1.0
    np.testing.assert_array_equal(whitened, ours)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_model_error_that_the_catalogue_lacks_is_counted_in(seed):
    # The measured coverage is in docs/repair.md.
    known, whitened, ours = errors("rotor_inertia", ("backlash_spring",), seed)
    assert known.widened > 10.0
    assert np.mean(whitened < 3.0) < 0.5
    assert np.mean(ours < 3.0) > 0.8


def test_a_mean_of_correlated_errors_is_as_uncertain_as_the_inflation_says():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2000, 600))
    for k in range(1, noise.shape[1]):
        noise[:, k] += 0.7 * noise[:, k - 1]
    means = noise.mean(axis=1)
    factors = [variance_inflation([row]) for row in noise[:200]]
    assert np.mean(factors) / 600 == pytest.approx(np.var(means), rel=0.2)
    assert variance_inflation([rng.standard_normal(5000)]) == pytest.approx(1.0, abs=0.2)
    assert variance_inflation([np.zeros(50)]) == 0.0
