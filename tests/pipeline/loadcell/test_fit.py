import math

import numpy as np
import pytest

from armdyn.errors import TaskFailedError
from pipeline.loadcell.fit import Plateau, Weight, fit_calibration, parse_weights

OFFSET, SCALE, NOISE = 84213.4, 5.6e-6, 40.0
G = 9.81


def counts_at(rng, force, samples=200, noise=NOISE, scale=SCALE):
    return np.round(OFFSET + force / scale + noise * rng.standard_normal(samples))


def fit(rng, text="0 g, 100 g, 200 g", **options):
    weights = parse_weights(text, G)
    return fit_calibration([Plateau.of(w, counts_at(rng, w.force, **options)) for w in weights], "test")


def assert_deviations_are_as_stated(z):
    """Deviations over their stated standard deviations: not larger than stated, and not far smaller."""
    z = np.asarray(z)
    bias = abs(z.mean()) * math.sqrt(len(z))
    assert bias < 4.0
    assert np.mean(np.abs(z) < 1.0) > 0.60  # 0.683 for a normal distribution
    assert np.mean(np.abs(z) < 3.0) > 0.985
    assert z.std() > 0.5


@pytest.mark.parametrize("text", ["0 g, 200 g", "0 g, 100 g, 200 g", "0 g, 50 g, 100 g, 200 g, 0 g"])
@pytest.mark.parametrize("scale", [SCALE, -SCALE])
def test_the_calibration_is_recovered_within_its_stated_deviations(text, scale):
    fits = [fit(np.random.default_rng(seed), text, scale=scale) for seed in range(400)]
    assert_deviations_are_as_stated([(f.offset - OFFSET) / f.offset_std for f in fits])
    assert_deviations_are_as_stated([(f.scale - scale) / f.scale_std for f in fits])
    assert np.mean([f.noise for f in fits]) == pytest.approx(NOISE * abs(scale), rel=0.02)


def test_weights_that_are_not_well_known_widen_the_scale_as_they_should():
    weights = parse_weights("0 g, 100 g +/- 0.5 g, 200 g +/- 0.5 g", G)
    z = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        true = [weight.force + weight.force_std * rng.standard_normal() for weight in weights]
        plateaus = [Plateau.of(w, counts_at(rng, f)) for w, f in zip(weights, true, strict=True)]
        found = fit_calibration(plateaus, "test")
        z.append((found.scale - SCALE) / found.scale_std)
    assert_deviations_are_as_stated(z)


def test_slow_drift_and_correlated_noise_widen_the_mean():
    weight, z = Weight("0 g", 0.0), []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        noise = np.zeros(400)
        for k in range(1, 400):
            noise[k] = 0.9 * noise[k - 1] + 17.0 * rng.standard_normal()
        plateau = Plateau.of(weight, np.round(OFFSET + noise[100:]))
        z.append((plateau.mean - OFFSET) / plateau.mean_std)
    assert np.mean(np.abs(z) < 3.0) > 0.95
    assert np.std(z) < 1.5


def test_a_few_wild_samples_change_nothing():
    rng = np.random.default_rng(5)
    clean = counts_at(rng, 0.5)
    wild = clean.copy()
    wild[[3, 50, 51, 120]] = [-8_000_000, 0, 1_000_000, 8_000_000]
    plateau = Plateau.of(Weight("x", 0.5), wild)
    assert plateau.outliers == 4
    assert plateau.mean == pytest.approx(clean.mean(), abs=3 * NOISE / math.sqrt(200) * 0.3)
    assert plateau.noise == pytest.approx(NOISE, rel=0.15)


def test_a_cell_quieter_than_its_counts_is_calibrated():
    rng = np.random.default_rng(6)
    found = fit(rng, noise=0.4)
    assert found.scale == pytest.approx(SCALE, rel=1e-5)


def test_residuals_are_what_the_line_leaves():
    rng = np.random.default_rng(7)
    weights = parse_weights("0 g, 100 g, 200 g", G)
    bent = [w.force + 3e-3 * (w.force == weights[1].force) for w in weights]  # 3 mN in the middle
    plateaus = [Plateau.of(w, counts_at(rng, f)) for w, f in zip(weights, bent, strict=True)]
    found = fit_calibration(plateaus, "test")
    # The best line through three even points with the middle one lifted by h leaves -h/3, 2h/3, -h/3.
    assert found.residuals == pytest.approx([-1e-3, 2e-3, -1e-3], abs=0.3e-3)
    # What the line does not explain is far more than the noise, and the stated deviation says so.
    assert found.offset_std * SCALE > 0.5e-3


@pytest.mark.parametrize(
    ("forces", "options", "says"),
    [
        ([0.0, 0.0, 0.0], {}, "same counts.*was the weight changed"),
        ([0.0, 0.981, 0.981], {}, "100 g and 200 g give the same counts"),
        ([0.0, 1.962, 0.981], {}, "do not follow the weights"),
        ([0.0, 0.981, 2.5], {}, "do not lie on a line"),
        ([0.0, 0.981, 1.962], {"noise": 30_000.0}, "the noise is .* % of the weights' span"),
    ],
)
def test_counts_that_are_no_calibration_are_refused(forces, options, says):
    rng = np.random.default_rng(8)
    weights = parse_weights("0 g, 100 g, 200 g", G)
    plateaus = [Plateau.of(w, counts_at(rng, f, **options)) for w, f in zip(weights, forces, strict=True)]
    with pytest.raises(TaskFailedError, match=says):
        fit_calibration(plateaus, "test")


def test_a_weight_that_still_swings_is_refused():
    rng = np.random.default_rng(9)
    weights = parse_weights("0 g, 100 g, 200 g", G)
    still = [Plateau.of(w, counts_at(rng, w.force)) for w in weights[:2]]
    angle = 0.15 * np.cos(5.2 * np.arange(200) / 80)
    swinging = Plateau.of(weights[2], counts_at(rng, 1.962 * (1 + 0.15**2 - 1.5 * angle**2)))
    with pytest.raises(TaskFailedError, match=r"200 g: the counts move .* let it come to rest"):
        fit_calibration([*still, swinging], "test")


def test_weights_closer_than_the_noise_are_refused():
    rng = np.random.default_rng(10)
    with pytest.raises(TaskFailedError, match=r"0 g and 0\.1 g cannot be told apart in the noise"):
        fit(rng, "0 g, 0.1 g, 200 g", samples=5000)


@pytest.mark.parametrize(
    ("counts", "says"),
    [
        ([5] * 10, "too few"),
        ([123] * 100, "stand still at 123"),
        ([100, 110, 0x7FFFFF] * 50, "end of its range"),
        ([100, 110, -0x800000] * 50, "end of its range"),
        ([100, 101, 102] * 50 + [9000, 12000] * 20, "far off: do not touch"),
    ],
)
def test_a_dead_saturated_or_touched_cell_is_refused(counts, says):
    with pytest.raises(TaskFailedError, match=says):
        Plateau.of(Weight("100 g", 0.981), counts)
