"""Properties of the kernel: sums say what samples say, whatever their order, units and scale; closed forms of scipy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_normal

from armdyn.estimation.correlation import autocorrelations, correlation_time
from armdyn.estimation.covariance import consider_covariance, covariance_root, free_covariance, sandwich_covariance
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.posterior import NormalPrior, freedom_nats, size_nats, wald_distance
from armdyn.estimation.random_effects import RandomEffects

SEEDS = st.integers(0, 2**32 - 1)
UNKNOWNS, STDS = 4, (0.5, 2.0, 1.0)


def drawn(seed: int) -> tuple[list[np.ndarray], list[np.ndarray], NormalEquations]:
    """Derivatives and residuals of three units, and their sums."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(UNKNOWNS, 30, len(STDS))
    X, r = [rng.standard_normal((n, UNKNOWNS)) for n in counts], [rng.standard_normal(n) for n in counts]
    parts = [NormalEquations.of_samples(*one) for one in zip(X, r, STDS, strict=True)]
    return X, r, NormalEquations.stacked(parts)


def prior_of(seed: int, bound: float = np.inf) -> NormalPrior:
    rng = np.random.default_rng([seed, 1])
    centre = np.zeros(UNKNOWNS) if bound < np.inf else rng.standard_normal(UNKNOWNS)
    bounds = np.full(UNKNOWNS, bound) * rng.uniform(0.5, 1.5, UNKNOWNS)
    return NormalPrior(rng.uniform(0.1, 3.0, UNKNOWNS), centre, -bounds, bounds)


def whole(X: list[np.ndarray], r: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Samples of all units over their noise."""
    return (
        np.vstack([x / s for x, s in zip(X, STDS, strict=True)]),
        np.concatenate([y / s for y, s in zip(r, STDS, strict=True)]),
    )


def close(found, expected, tolerance: float = 1e-8) -> None:
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_sums_tell_errors_likelihoods_and_fits_as_the_samples_do(seed):
    X, r, sums = drawn(seed)
    change, units = np.random.default_rng(seed).standard_normal(UNKNOWNS), np.arange(len(STDS))
    left = [(y - x @ change) / s for x, y, s in zip(X, r, STDS, strict=True)]
    squares = [e @ e for e in left]
    close(sums.squared_error(change, units), squares)
    close(sums.squared_errors(change[:, None])[:, 0], squares)
    close(sums.grouped(np.array([0, 1, 0]), 3).squared_error(change, units), [squares[0] + squares[2], squares[1], 0.0])
    moved = sums.after_change(np.array([0, 2]), change[[0, 2]], np.array([1, 3]))
    close(moved.squared_error(change[[1, 3]], units), squares)
    close(
        moved.among(np.array([1, 3]), 5).squared_error(np.array([9.0, change[1], 9.0, change[3], 9.0]), units), squares
    )
    density = [
        multivariate_normal(cov=(2.0 * s) ** 2).logpdf(y - x @ change).sum() + 0.5 * len(y) * np.log(2.0 * np.pi)
        for x, y, s in zip(X, r, STDS, strict=True)
    ]
    at = sums.after_change(np.arange(UNKNOWNS), change, np.arange(UNKNOWNS))
    close(at.log_likelihood(np.full(len(STDS), 2.0)), density)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_order_units_and_scale_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    X, r, sums = drawn(seed)
    mixed, size = [rng.permutation(len(y)) for y in r], 10.0 ** rng.uniform(-3, 3, UNKNOWNS)
    again = [NormalEquations.of_samples(size * x[m], y[m], s) for x, y, m, s in zip(X, r, mixed, STDS, strict=True)]
    weight, units = np.ones(len(STDS)), np.arange(len(STDS))
    prior = prior_of(seed, 0.2)
    there = NormalPrior(*(part / size for part in (prior.width, prior.centre, prior.lower, prior.upper)))
    here = prior.posterior(*sums.weighted(weight, units))
    scaled = there.posterior(*NormalEquations.stacked(again[::-1]).weighted(weight, units))
    close(scaled.change * size, here.change)
    close(scaled.covariance * np.outer(size, size), here.covariance)
    close(scaled.gain_beyond_bound_nats, here.gain_beyond_bound_nats)
    close(scaled.squared_error_change, here.squared_error_change)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_a_posterior_is_the_least_squares_solution_of_samples_and_priors_within_bounds(seed):
    X, r, sums = drawn(seed)
    prior = prior_of(seed, 0.2)
    found = prior.posterior(*sums.weighted(np.ones(len(STDS)), np.arange(len(STDS))))
    columns, target = whole(X, r)
    peer = lsq_linear(
        np.vstack([columns, np.diag(1.0 / prior.width)]), np.append(target, prior.centre / prior.width),
        (prior.lower, prior.upper), method="bvls", tol=1e-14,
    )  # fmt: skip
    close(found.change, peer.x, 1e-7)
    close(found.squared_error_change, 2.0 * peer.cost - target @ target, 1e-6)
    pull = found.slope - found.information @ found.change + (prior.centre - found.change) / prior.width**2
    assert np.all((found.on_bound == 0) | (pull * found.on_bound >= -1e-9))
    close(pull[found.on_bound == 0], 0.0, 1e-7)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_evidence_is_the_density_of_the_samples_with_the_unknowns_integrated_out(seed):
    """With the prior mean 0: log p(r) = [-r'r + reduction - log det(1 + W H W)] / 2."""
    X, r, sums = drawn(seed)
    prior = NormalPrior(prior_of(seed).width, *(np.full(UNKNOWNS, k) for k in (0.0, -np.inf, np.inf)))
    columns, target = whole(X, r)
    information, slope = sums.weighted(np.ones(len(STDS)), np.arange(len(STDS)))
    change, squares = prior.unbounded_change(information, slope)
    close(change, prior.posterior(information, slope).change)
    level = -0.5 * (target @ target + squares) - freedom_nats(information, prior.width)
    marginal = multivariate_normal(cov=np.eye(len(target)) + columns * prior.width**2 @ columns.T).logpdf(target)
    close(level - 0.5 * len(target) * np.log(2.0 * np.pi), marginal, 1e-7)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_what_is_predicted_is_what_a_fit_without_a_unit_predicts_of_it(seed):
    X, r, sums = drawn(seed)
    prior, others = prior_of(seed), np.array([0, 1])
    found = prior.posterior(*sums.weighted(np.ones(2), others))
    columns, target = (part[: sum(len(y) for y in r[:2])] for part in whole(X, r))
    refit = np.linalg.lstsq(
        np.vstack([columns, np.diag(1.0 / prior.width)]), np.append(target, prior.centre / prior.width)
    )[0]
    close(sums.squared_error(found.change, np.array([2])), [np.sum((r[2] - X[2] @ refit) ** 2)])
    close(found.covariance, np.linalg.inv(columns.T @ columns + np.diag(prior.width**-2.0)))


def test_the_price_of_a_size_is_that_of_a_cauchy_distribution():
    weight = quad(lambda x: np.exp(-size_nats(np.array([x]))), -np.inf, np.inf)[0]
    close(weight, np.pi)


def test_a_wald_distance_is_that_of_scaled_axes_and_leaves_out_values_without_variance():
    close(wald_distance(np.array([3.0, 8.0]), np.diag([1.0, 4.0])), 5.0)
    close(wald_distance(np.array([3.0, 8.0]), np.diag([1.0, 0.0])), 3.0)


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_groups_of_samples_are_units_also_without_a_sample(seed):
    rng = np.random.default_rng(seed)
    X, r, group = rng.standard_normal((20, UNKNOWNS)), rng.standard_normal(20), np.sort(rng.integers(0, 4, 20))
    found = NormalEquations.of_groups(X, r, 2.0, group, 5)
    change = rng.standard_normal(UNKNOWNS)
    left = (r - X @ change) / 2.0
    close(found.squared_error(change, np.arange(5)), [np.sum(left[group == k] ** 2) for k in range(5)])
    assert found.count.tolist() == [np.sum(group == k) for k in range(5)]


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_units_at_once_and_windows_are_the_sums_of_their_parts(seed):
    rng = np.random.default_rng(seed)
    X, r, std = rng.standard_normal((6, 5, UNKNOWNS)), rng.standard_normal((6, 5)), rng.uniform(0.5, 2.0, (6, 5))
    left_out = rng.random((6, 5)) < 0.2
    left_out[:, 0] = False  # a unit without samples has no sums to compare
    sums = NormalEquations.of_units(X, r, np.where(left_out, np.inf, std))
    one_by_one = NormalEquations.stacked([
        NormalEquations.stacked(
            [NormalEquations.of_samples(X[u, [i]], r[u, [i]], std[u, i]) for i in np.flatnonzero(~left_out[u])]
        ).grouped(np.zeros((~left_out[u]).sum(), dtype=int), 1)
        for u in range(6)
    ])  # fmt: skip
    twos = sums.only(np.array([0, 2, 1, 3, 2, 4, 3, 5])).grouped(np.repeat(np.arange(4), 2), 4)
    for name in ("gram", "slope", "square", "count", "log_std"):
        close(getattr(sums, name), getattr(one_by_one, name))
        close(getattr(sums.windows(2, 2), name), getattr(twos, name))


@given(SEEDS)
@settings(deadline=None, max_examples=50)
def test_random_effects_integrated_out_leave_the_density_of_the_samples(seed):
    """Two groups with scatters of their own, of the last two unknowns; units of which some group has several."""
    rng = np.random.default_rng(seed)
    X, r = rng.standard_normal((4, 9, UNKNOWNS)), rng.standard_normal((4, 9))
    root = rng.standard_normal((2, 2, 2))
    random = RandomEffects(rng.standard_normal((2, 2)), root @ root.swapaxes(1, 2), rng.uniform(0.5, 2.0, 2))
    columns, change = np.array([2, 3]), rng.standard_normal(UNKNOWNS)
    sums = random.integrated_out(NormalEquations.of_units(X, r, np.full(r.shape, 1.5)), columns)
    close(sums.gram, sums.gram.swapaxes(1, 2))
    after = sums.after_change(np.arange(UNKNOWNS), change, np.arange(UNKNOWNS))
    for u, level in enumerate(after.log_likelihood(np.ones(4)) - 4.5 * np.log(2.0 * np.pi)):
        x, (m, P, n) = X[u][:, columns], (part[u % 2] for part in (random.mean, random.scatter, random.noise))
        # The sums weigh by the noise; the scatter is of the unknowns, and n a factor of the noise.
        whole = multivariate_normal(x @ m, n * 1.5**2 * np.eye(9) + x @ P @ x.T)
        close(level, whole.logpdf(r[u] - X[u] @ change))


def test_random_effects_say_how_the_slopes_of_other_units_scatter():
    """400 units in two groups; noise that is correlated, so that only the units' scatter tells how much there is."""
    rng, units, alike = np.random.default_rng(0), 400, 5
    m, std = np.array([[1.0, -2.0], [0.0, 0.5]]), np.array([[0.5, 0.3], [1.0, 0.4]])

    def equations() -> NormalEquations:
        X = rng.standard_normal((2 * units, 6, 2)) * rng.uniform(0.2, 2.0, (2 * units, 1, 1))
        unknown = np.tile(m, (units, 1)) + np.tile(std, (units, 1)) * rng.standard_normal((2 * units, 2))
        r = (X @ unknown[..., None])[..., 0] + rng.standard_normal((2 * units, 6))
        X, r = np.repeat(X, alike, axis=1), np.repeat(r, alike, axis=1)
        return NormalEquations.of_units(X, r, np.ones(r.shape))

    found, others = RandomEffects.fitted(equations(), np.zeros(2), units, 0.0), equations()
    np.testing.assert_allclose(found.mean, m, atol=4.0 * np.max(std) / np.sqrt(units))
    P, n = (np.tile(part, (units, *[1] * (part.ndim - 1))) for part in (found.scatter, found.noise))
    S, away = others.gram, others.slope - (others.gram @ np.tile(found.mean, (units, 1))[..., None])[..., 0]
    expected = S @ P @ S + n[:, None, None] * S
    square = np.einsum("up,upq,uq->u", away, np.linalg.inv(expected), away).reshape(units, 2) / 2.0
    np.testing.assert_allclose(square.mean(axis=0), 1.0, atol=4.0 / np.sqrt(units))
    np.testing.assert_allclose(found.noise, alike, rtol=0.5)


@given(SEEDS)
@settings(deadline=None, max_examples=30)
def test_covariances_are_those_of_the_free_unknowns_in_any_units(seed):
    X, _, sums = drawn(seed)
    rows, _ = whole(X, [np.zeros(len(x)) for x in X])
    information = sums.gram.sum(axis=0)
    free = np.array([True, False, True, True])
    true = np.zeros((UNKNOWNS, UNKNOWNS))
    true[np.ix_(free, free)] = np.linalg.inv(rows[:, free].T @ rows[:, free])
    close(free_covariance(information, free), true)
    size = 10.0 ** np.random.default_rng(seed).uniform(-4, 4, UNKNOWNS)
    for negligible in (None, 1e-13):
        close(free_covariance(information * np.outer(size, size), free, negligible) * np.outer(size, size), true)
    root = covariance_root(information)
    close(root @ root.T @ information, np.eye(UNKNOWNS))
    inverse = free_covariance(information, free)
    close(sandwich_covariance(inverse, 4.0 * information), 4.0 * inverse)


def test_a_sandwich_is_the_scatter_of_fits_whose_errors_are_not_as_assumed():
    rng = np.random.default_rng(11)
    X = np.column_stack([np.ones(40), np.linspace(-1.0, 1.0, 40)])
    std = np.where(X[:, 1] > 0.0, 3.0, 0.5)
    fits = np.linalg.lstsq(X, std[:, None] * rng.standard_normal((40, 20000)), rcond=None)[0]
    found = sandwich_covariance(free_covariance(X.T @ X, np.ones(2, dtype=bool)), X.T @ (std[:, None] ** 2 * X))
    np.testing.assert_allclose(found, np.cov(fits), rtol=0.05, atol=1e-3)


def test_an_unknown_that_nothing_tells_is_very_uncertain_unless_that_is_called_known():
    information, free = np.array([[1.0, 1.0], [1.0, 1.0]]), np.ones(2, dtype=bool)
    assert free_covariance(information, free)[0, 0] > 1e10
    close(free_covariance(information, free, 1e-13), np.full((2, 2), 0.25))


def test_the_correlation_time_of_an_autoregression_is_its_closed_form():
    rng, x = np.random.default_rng(2), np.zeros(200_000)
    noise = rng.standard_normal(len(x))
    for k in range(1, len(x)):
        x[k] = 0.8 * x[k - 1] + noise[k]
    assert abs(correlation_time([x]) - 1.8 / 0.2) < 0.9
    assert [lag for lag, _ in autocorrelations([x], 30, 0.5)] == [1, 2, 3]
    assert correlation_time([noise]) < 1.1
    assert list(autocorrelations([np.zeros(5)])) == []


@given(SEEDS)
def test_an_assumed_quantity_widens_values_as_if_it_were_fitted_with_its_prior(seed):
    X = np.random.default_rng(seed).standard_normal((30, UNKNOWNS + 1))
    H, width = X.T @ X, 0.3
    whole = np.linalg.inv(H + np.diag([0.0] * UNKNOWNS + [width**-2]))
    inverse, across = np.linalg.inv(H[:-1, :-1]), H[:-1, -1]
    change = -inverse @ across
    added = consider_covariance(change[:, None], np.array([width]), H[-1, -1] + across @ change)
    np.testing.assert_allclose(inverse + added, whole[:-1, :-1], rtol=1e-9, atol=1e-12)
