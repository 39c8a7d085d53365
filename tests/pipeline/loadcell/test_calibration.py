"""A calibration: from weights and counts to a line, to a file and back."""

import contextlib
import math
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from armdyn.errors import InputError, TaskFailedError
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.fit import KnownWeight, WeightMeasurement, fit_calibration, parse_weights

CALIBRATION = Calibration(
    84213.5, 2.5, -5.6e-6, 6e-11, 2.2e-4, datetime(2026, 3, 2, 10, 15, tzinfo=UTC), 'calibrate COM3: "0 g", ü'
)


def test_a_stored_calibration_comes_back_to_the_last_digit_and_gives_forces(tmp_path):
    path = tmp_path / "new folder" / "loadcell.toml"
    CALIBRATION.save(path)
    assert Calibration.load(path) == CALIBRATION
    assert [file.name for file in path.parent.iterdir()] == ["loadcell.toml"]
    assert CALIBRATION.force(84213.5) == 0.0
    assert CALIBRATION.force(84213.5 - 100_000) == pytest.approx(0.56)
    assert CALIBRATION.counts(0.56) == pytest.approx(84213.5 - 100_000)


def test_the_file_of_the_document_is_a_calibration(tmp_path):
    document = (Path(__file__).parents[3] / "docs" / "loadcell.md").read_text()
    (tmp_path / "a.toml").write_text(re.search(r"```toml\n(.*?)```", document, re.DOTALL).group(1))
    assert Calibration.load(tmp_path / "a.toml").scale == 5.60005e-06


SPOILED = [
    ("84213.5", "nan"), ("84213.5", "1e9"), ("84213.5", '"84213.5"'), ("84213.5", "true"), ("-5.6e-06", "0.0"),
    ("-5.6e-06", "inf"), ("0.00022", "0.0"), ("0.00022", "-1.0"), ("N/count", "g/count"), ("scale", "slope"),
    ("offset =", "offset = 3 #"), ("2026-03-02T10:15:00Z", "2026-03-02"), ("2026-03-02T10:15:00Z", '"yesterday"'),
    ("source = ", "source = 3 # "), ("{", ""),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new"), SPOILED)
def test_a_calibration_that_cannot_be_used_says_so_in_one_line(tmp_path, old, new, complains):
    path = tmp_path / "loadcell.toml"
    CALIBRATION.save(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with complains(InputError):
        Calibration.load(path)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00", b"folder"])
def test_a_missing_or_foreign_file_says_what_to_run(tmp_path, content, complains):
    path = tmp_path / "loadcell.toml"
    if content == b"folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with complains(InputError):
        Calibration.load(path)


def test_a_calibration_that_cannot_be_written_leaves_nothing_behind(tmp_path, complains):
    (tmp_path / "file").write_text("in the way")
    with complains(InputError):
        CALIBRATION.save(tmp_path / "file" / "loadcell.toml")
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_weights_are_masses_or_forces():
    weights = parse_weights("0 g, 100 g +/- 0.1 g, 0.2 kg, 3 N", 9.81)
    assert [weight.force for weight in weights] == pytest.approx([0.0, 0.981, 1.962, 3.0])
    assert [weight.force_std for weight in weights] == pytest.approx([0.0, 0.000981, 0.0, 0.0])
    # The empty cell comes first even if it is not listed.
    assert [weight.text for weight in parse_weights("100 g, 200 g", 9.81)] == ["0 g", "100 g", "200 g"]


@pytest.mark.parametrize(
    "text", ["", ",", "0 g", "0 g, 0 N", "100", "0 g, -100 g", "0 g, 2 s", "0 g, heavy", "0 g; 100 g"]
)
def test_nonsense_weights_are_refused_in_one_line(text, complains):
    with complains(InputError):
        parse_weights(text, 9.81)


OFFSET, SCALE, NOISE = 84213.4, 5.6e-6, 40.0
G = 9.81


def counts_at(rng, force, samples=200, noise=NOISE, scale=SCALE):
    return np.round(OFFSET + force / scale + noise * rng.standard_normal(samples))


def plateaus_at(rng, weights, forces, **options):
    """The cell's answers to forces that are not always those of the weights."""
    return [
        WeightMeasurement.from_counts(w, counts_at(rng, force, **options))
        for w, force in zip(weights, forces, strict=True)
    ]


def assert_deviations_are_as_stated(z):
    """Deviations over their stated standard deviations: not larger than stated, and not far smaller."""
    z = np.asarray(z)
    bias = abs(z.mean()) * math.sqrt(len(z))
    assert bias < 4.0
    assert np.mean(np.abs(z) < 1.0) > 0.60  # 0.683 for a normal distribution
    assert np.mean(np.abs(z) < 3.0) > 0.985
    assert z.std() > 0.5


@pytest.mark.parametrize(
    "text", ["0 g, 200 g", "0 g, 50 g, 100 g, 200 g, 0 g", "0 g, 100 g +/- 0.5 g, 200 g +/- 0.5 g"]
)
@pytest.mark.parametrize("scale", [SCALE, -SCALE])
def test_the_calibration_is_recovered_within_its_stated_deviations(text, scale):
    weights, fits = parse_weights(text, G), []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        true = [weight.force + weight.force_std * rng.standard_normal() for weight in weights]
        fits.append(fit_calibration(plateaus_at(rng, weights, true, scale=scale), "test"))
    assert_deviations_are_as_stated([(f.offset - OFFSET) / f.offset_std for f in fits])
    assert_deviations_are_as_stated([(f.scale - scale) / f.scale_std for f in fits])
    assert np.mean([f.noise for f in fits]) == pytest.approx(NOISE * abs(scale), rel=0.02)


@pytest.mark.parametrize("change", [lambda c: c + 5e4, lambda c: -3.0 * c, lambda c: 0.25 * c])
def test_a_fit_of_other_counts_is_the_same_fit_in_other_counts_whatever_the_order_of_the_weights(change):
    rng = np.random.default_rng(2)
    weights = parse_weights("0 g, 50 g +/- 0.1 g, 100 g, 200 g", G)
    counts = [NOISE * 20 * rng.standard_normal(200) + w.force / SCALE for w in weights]
    one = fit_calibration([WeightMeasurement.from_counts(w, c) for w, c in zip(weights, counts, strict=True)], "test")
    other = fit_calibration(
        [WeightMeasurement.from_counts(w, change(c)) for w, c in zip(weights[::-1], counts[::-1], strict=True)], "t"
    )
    zero, slope = change(0.0), change(1.0) - change(0.0)
    assert other.offset == pytest.approx(zero + slope * one.offset, rel=1e-9)
    assert other.offset_std == pytest.approx(abs(slope) * one.offset_std, rel=1e-6)
    assert other.scale == pytest.approx(one.scale / slope, rel=1e-9)
    assert other.scale_std == pytest.approx(one.scale_std / abs(slope), rel=1e-6)
    assert other.noise == pytest.approx(one.noise, rel=1e-9)
    assert other.residuals[::-1] == pytest.approx(one.residuals, rel=1e-6, abs=1e-12)


def test_slow_drift_and_correlated_noise_widen_the_mean():
    weight, z = KnownWeight("0 g", 0.0), []
    for seed in range(400):
        noise = lfilter([17.0], [1.0, -0.9], np.random.default_rng(seed).standard_normal(400))
        plateau = WeightMeasurement.from_counts(weight, np.round(OFFSET + noise[100:]))
        z.append((plateau.mean - OFFSET) / plateau.mean_std)
    assert np.mean(np.abs(z) < 3.0) > 0.95
    assert np.std(z) < 1.5


@pytest.mark.parametrize(("wild", "refused"), [(20, False), (21, True)])
def test_a_tenth_of_the_samples_may_be_wild_and_what_is_within_five_deviations_is_not(wild, refused, complains):
    rng = np.random.default_rng(1)
    counts = OFFSET + NOISE * rng.permutation(np.linspace(-1.4826, 1.4826, 200))  # the median deviation is half of that
    limit = 5.0 * 1.4826 * np.median(np.abs(counts - np.median(counts)))
    counts[:wild] = OFFSET + 1.2 * limit
    counts[100] = OFFSET - 0.9 * limit
    if refused:
        with complains(TaskFailedError):
            WeightMeasurement.from_counts(KnownWeight("x", 1.0), counts)
    else:
        plateau = WeightMeasurement.from_counts(KnownWeight("x", 1.0), counts)
        assert (plateau.outliers, plateau.samples) == (20, 180)
        assert plateau.mean == pytest.approx(counts[wild:].mean())
        assert plateau.noise == pytest.approx(counts[wild:].std(ddof=1))
        assert plateau.mean_std == pytest.approx(plateau.noise / np.sqrt(180))


def test_a_cell_quieter_than_its_counts_is_calibrated():
    weights = parse_weights("0 g, 100 g, 200 g", G)
    plateaus = plateaus_at(np.random.default_rng(6), weights, [w.force for w in weights], noise=0.4)
    assert fit_calibration(plateaus, "test").scale == pytest.approx(SCALE, rel=1e-5)


def test_residuals_are_what_the_line_leaves():
    weights = parse_weights("0 g, 100 g, 200 g", G)
    bent = [w.force + 3e-3 * (w.force == weights[1].force) for w in weights]  # 3 mN in the middle
    found = fit_calibration(plateaus_at(np.random.default_rng(7), weights, bent), "test")
    # The best line through three even points with the middle one lifted by h leaves -h/3, 2h/3, -h/3.
    assert found.residuals == pytest.approx([-1e-3, 2e-3, -1e-3], abs=0.3e-3)
    # What the line does not explain is far more than the noise, and the stated deviation says so.
    assert found.offset_std * SCALE > 0.5e-3


@pytest.mark.parametrize(
    ("text", "forces", "options"),
    [
        ("0 g, 100 g, 200 g", [0.0, 0.0, 0.0], {}),
        ("0 g, 100 g, 200 g", [0.0, 0.981, 0.981], {}),
        ("0 g, 100 g, 200 g", [0.0, 1.962, 0.981], {}),
        ("0 g, 100 g, 200 g", [0.0, 0.981, 2.5], {}),
        ("0 g, 100 g, 200 g", [0.0, 0.981, 1.962], {"noise": 30_000.0}),
        ("0 g, 0.1 g, 200 g", [0.0, 0.000981, 1.962], {"samples": 5000}),  # closer than the noise
    ],
)
def test_counts_that_are_no_calibration_are_refused(text, forces, options, complains):
    weights = parse_weights(text, G)
    plateaus = plateaus_at(np.random.default_rng(8), weights, forces, **options)
    with complains(TaskFailedError):
        fit_calibration(plateaus, "test")


@pytest.mark.parametrize(
    ("share", "noise", "refused"), [(0.009, NOISE, False), (0.011, NOISE, True), (0.02, 14_000.0, False)]
)
def test_a_hundredth_of_the_span_beside_the_line_is_a_wrong_weight_unless_it_is_noise(share, noise, refused):
    weights, wiggle = parse_weights("0 g, 100 g, 200 g", G), noise * np.resize([1.0, -1.0], 40)
    span = weights[2].force / SCALE
    counts = [w.force / SCALE + wiggle + 1.5 * share * span * (k == 1) for k, w in enumerate(weights)]
    plateaus = [WeightMeasurement.from_counts(w, c) for w, c in zip(weights, counts, strict=True)]
    with pytest.raises(TaskFailedError, match="100 g is off") if refused else contextlib.nullcontext():
        assert max(fit_calibration(plateaus, "test").residuals) == pytest.approx(share * weights[2].force, rel=1e-2)


def test_a_weight_that_still_swings_is_refused(complains):
    rng = np.random.default_rng(9)
    weights = parse_weights("0 g, 100 g, 200 g", G)
    still = [WeightMeasurement.from_counts(w, counts_at(rng, w.force)) for w in weights[:2]]
    angle = 0.15 * np.cos(5.2 * np.arange(200) / 80)
    swinging = WeightMeasurement.from_counts(weights[2], counts_at(rng, 1.962 * (1 + 0.15**2 - 1.5 * angle**2)))
    with complains(TaskFailedError):
        fit_calibration([*still, swinging], "test")


SICK = {
    "too few": [5] * 10, "dead": [123] * 100, "saturated": [100, 110, 0x7FFFFF] * 50,
    "saturated below": [100, 110, -0x800000] * 50, "touched": [100, 101, 102] * 50 + [9000, 12000] * 20,
}  # fmt: skip


@pytest.mark.parametrize("counts", SICK.values(), ids=SICK)
def test_a_dead_saturated_or_touched_cell_is_refused(counts, complains):
    with complains(TaskFailedError):
        WeightMeasurement.from_counts(KnownWeight("100 g", 0.981), counts)
