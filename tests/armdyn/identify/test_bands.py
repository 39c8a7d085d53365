"""Bands cover what they say in runs that nothing was fitted to, grow with what values leave open, and are shown."""

import numpy as np
import pytest
from worlds.pendulum import Setup, record, weighed

from armdyn.identify.bands import prediction_bands
from armdyn.identify.compare import compare
from armdyn.identify.studies import make_study
from armdyn.identify.uncertainty import uncertainty
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.units import KnownQuantity
from pipeline.answers import comparison_json


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
