import numpy as np
import pytest
from derivatives import assert_jacobian

from armdyn.experiments.criteria import Conditioned, Determined, Hidden, Separated

P = 7
RNG = np.random.default_rng(0)
ROWS = RNG.standard_normal((30, P)) * np.linspace(1.0, 4.0, P)
PRIOR = np.array([10.0, 10.0, 2.0, np.inf, 10.0, 1.0, 10.0])
HIDDEN = (
    Hidden("a", "j", "b", np.array([0, 1]), np.array([2, 3, 6]), np.eye(2)),
    Hidden("b", "j", "a", np.array([2, 3]), np.array([0, 1, 6]), np.array([[0.6], [0.8]])),
)
CRITERIA = {
    "determined": Determined(np.array([0, 3, 5]), PRIOR),
    "separated": Separated(HIDDEN, PRIOR),
    "conditioned": Conditioned(np.array([0, 1, 3, 4]), np.linspace(0.5, 2.0, P)),
}


@pytest.mark.parametrize("name", CRITERIA)
def test_derivatives_are_exact(name):
    criterion = CRITERIA[name]
    _, slopes = criterion(ROWS.T @ ROWS)
    assert slopes == pytest.approx(slopes.T)

    def of_rows(flat):
        X = flat.reshape(ROWS.shape)
        return np.array([criterion(X.T @ X)[0]])

    assert_jacobian(of_rows, ROWS.ravel(), (2.0 * ROWS @ slopes).ravel()[None], 1e-3, 1e-5)


def test_determined_is_the_mean_logarithm_of_the_standard_deviations_of_a_fit():
    """Of one unknown alone: that of the least-squares problem with the priors as further rows."""
    wanted, prior = 4, np.full(P, 3.0)
    whole = np.vstack([ROWS, np.diag(1.0 / prior)])
    variance = np.linalg.inv(whole.T @ whole)[wanted, wanted]
    value, _ = Determined(np.array([wanted]), prior)(ROWS.T @ ROWS)
    assert value == pytest.approx(0.5 * np.log(variance))


def test_a_separation_is_what_a_refit_of_the_rival_leaves():
    """Brute force: the hidden change as data, the rival and the nuisance fitted to it with their priors."""
    case = HIDDEN[0]
    left = case.left(ROWS.T @ ROWS, PRIOR)
    for change in (np.array([1.0, 0.0]), np.array([-0.3, 2.0])):
        X = np.vstack([ROWS[:, case.fitted], np.diag(1.0 / PRIOR[case.fitted])])
        data = np.concatenate([ROWS[:, case.own] @ change, np.zeros(len(case.fitted))])
        refit, *_ = np.linalg.lstsq(X, data, rcond=None)
        assert float(np.sum((data - X @ refit) ** 2)) == pytest.approx(change @ left @ change)
    angles = np.linspace(0.0, np.pi, 400)
    smallest = min(d @ left @ d for d in np.column_stack([np.cos(angles), np.sin(angles)]))
    assert case.separation(ROWS.T @ ROWS, PRIOR) == pytest.approx(smallest, rel=1e-3)


def test_conditioned_is_the_condition_number_of_the_regression():
    case = CRITERIA["conditioned"]
    X = ROWS[:, case.independent] / case.typical[case.independent]
    assert case(ROWS.T @ ROWS)[0] == pytest.approx(np.log(np.linalg.cond(X)))
