"""Bands cover what they say in runs that nothing was fitted to, grow with what values leave open, and are shown."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from worlds.pendulum import Setup, record, weighed

from armdyn.identify.bands import prediction_bands
from armdyn.identify.compare import compare
from armdyn.identify.studies import make_study
from armdyn.identify.uncertainty import uncertainty
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run
from pipeline.answers import comparison_json
from pipeline.report.overlay import study_overlays


def recordings(seed: int, count: int) -> list:
    rng = np.random.default_rng(seed)
    known = KnownQuantity(0.0802, 4e-4, "kg"), KnownQuantity(0.3685, 1e-3, "m")
    return [weighed(record(f"{seed}_{k}.csv", Setup(duration=8.0), rng), *known) for k in range(count)]


def test_of_noise_alone_95_of_100_samples_of_an_exam_are_within() -> None:
    covered = []
    for seed in range(12):
        one, two, three, exam = recordings(seed, 4)
        found = compare(make_study(pendulum_model(0.35, 0.1), [one, two], [three], [], [exam]))
        covered += list(found.bands.coverage.values())
    # 800 samples that hardly repeat themselves in each run: a standard deviation of 0.008 for one, 0.003 for all.
    assert np.mean(covered) == pytest.approx(0.95, abs=0.01)


def test_a_band_grows_where_values_are_uncertain_that_move_the_prediction() -> None:
    one, two, exam = recordings(3, 3)
    study = make_study(pendulum_model(0.35, 0.1), [one], [two], [], [exam])
    fit = study.first()
    covariance = uncertainty(study, fit).covariance
    growth = []
    for factor in (0.0, 1e4):
        width = prediction_bands(study, fit, factor * covariance).half_width[exam.name, "load_force"]
        growth.append(width.max() / width.min())
    assert growth[0] == pytest.approx(1.0)
    assert growth[1] > 1.2


def test_json_frame_and_figure_have_the_bands() -> None:
    (one, two) = recordings(4, 2)
    study = make_study(pendulum_model(0.35, 0.1), [one, two], [], [])
    found = compare(study)
    answer = comparison_json(study, found)["bands"]["load_force"]
    assert answer["level"] == 0.95
    assert 0.9 < answer["covered"] < 1.0
    table = found.to_dataframe("samples")
    inside = (table.measured - table.predicted).abs() <= table.half_width
    assert inside.mean() == pytest.approx(0.95, abs=0.02)
    filled = [trace for trace in found.plot().data if trace.fill == "toself"]
    assert len(filled) == 2


@pytest.mark.parametrize(("amplitude", "drag", "told"), [(0.32, 0.05, False), (0.8, 0.0, False), (0.8, 0.05, True)])
def test_an_exam_that_leaves_its_band_beyond_the_range_of_the_fitted_runs_is_named(amplitude, drag, told) -> None:
    """Drag with the square of the speed, which the model lacks, grows with the amplitude; without it the band holds."""
    rng = np.random.default_rng(5)
    one, two, exam = (
        swing(f"{name}.csv", at, drag, rng) for name, at in (("one", 0.3), ("two", 0.35), ("exam", amplitude))
    )
    study = make_study(pendulum_model(0.35, 0.1), [one, two], [], [], [exam])
    found = compare(study)
    said = [text for text in found.left_out if "band does not hold" in text]
    assert bool(said) is told
    answer = comparison_json(study, found)["bands"]["swing_angle"]
    assert answer["does_not_hold_in"] == (["exam.csv"] if told else [])
    overlays = study_overlays(study, [found.fit], bands=found.bands)
    assert {one.run for one in overlays if one.half_width is None} == ({"exam.csv"} if told else set())
    if told:
        assert said[0].startswith("exam.csv: swing_")
        size = 1.0 if said[0].split()[1] == "swing_angle" else np.sqrt(9.81 / 0.35)
        assert 0.35 * size < abs(float(re.search(r"comes to (\S+) ", said[0])[1])) < amplitude * size


def swing(name: str, amplitude: float, drag: float, rng: np.random.Generator) -> Run:
    """A free swing by scipy."""
    time = np.arange(0.0, 6.0, 0.01)
    angle = solve_ivp(
        lambda _, s: [s[1], -9.80665 / 0.35 * np.sin(s[0]) - drag * s[1] * abs(s[1])], (0.0, 6.0), (amplitude, 0.0),
        t_eval=time, rtol=1e-9, atol=1e-11,
    ).y[0]  # fmt: skip
    return Run(name, {"swing_angle": Channel(time, angle + 1e-3 * rng.normal(size=len(time)), "rad")})


def test_a_delay_that_ends_on_its_bound_is_told_although_it_is_no_parameter_of_the_model() -> None:
    found = compare(make_study(pendulum_model(0.35, 0.1), recordings(4, 1), [], []))
    fitted = found.fit.problem.columns[0].name
    (_, said, *_) = replace(found, parameters={}, at_bound=(fitted,)).remarks
    assert said.startswith(f"{fitted} ended on its physical bound, {found.parameters[fitted].value:.4g} ")
