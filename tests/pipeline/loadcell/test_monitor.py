"""What `armdyn loadcell` shows and answers, against plain statistics of what came."""

import io
import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pipeline.loadcell.faults import LoadCellFault, LoadCellFaultEvent, LoadCellStatus
from pipeline.loadcell.fit import CalibrationFit, KnownWeight, WeightMeasurement
from pipeline.loadcell.monitor import (
    STATISTICS_WINDOW_SECONDS,
    ForceStatistics,
    calibration_json,
    calibration_table,
    monitor_json,
    monitor_table,
)
from pipeline.robot.protocol import ForceSample

STATUS = LoadCellStatus(
    True, 3, 79.96, (LoadCellFault.FROZEN,), {**dict.fromkeys(LoadCellFault, 0), LoadCellFault.MALFORMED: 2}
)
EMPTY = WeightMeasurement(KnownWeight("0 g", 0.0), 84213.4, 1.0, 40.0, 60, 1)
LOADED = WeightMeasurement(KnownWeight("100 g", 0.981), -90962.5, 2.0, 41.0, 59, 2)
FIT = CalibrationFit(
    84213.44, 1.26, -5.60005e-6, 2.34e-10, 2.24e-4, datetime(2026, 3, 2, tzinfo=UTC), "test", (EMPTY, LOADED),
    (1e-6, -2.5e-5),
)  # fmt: skip


def shown(table):
    """Words of what stands on a screen, without the frames of tables."""
    file = io.StringIO()
    Console(file=file, width=160).print(table)
    return " ".join(word for word in file.getvalue().split() if not set(word) & set("│┃━┏┓┗┛┡┩─└┘┌┐┳┬┴╇"))


@given(
    st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=60),
    st.lists(st.sampled_from([1e-3, 0.02, 0.5, 1.5]), min_size=60, max_size=60),
    st.integers(1, 60),
)
def test_figures_are_those_of_numpy_however_the_samples_come(forces, steps, at):
    time = np.cumsum(steps[: len(forces)])
    samples = [ForceSample(float(t), 1e3 + f) for t, f in zip(time, forces, strict=True)]
    seen = ForceStatistics()
    assert (math.isnan(seen.latest[0]), math.isnan(seen.std)) == (True, True)
    for part in (samples[:at], samples[at:]):
        seen.add(part, [])
    values = np.array([sample.force for sample in samples])
    assert (seen.samples, seen.minimum, seen.maximum) == (len(values), values.min(), values.max())
    assert (seen.mean, seen.std) == pytest.approx((values.mean(), values.std(ddof=1)), abs=1e-9)
    last = values[time >= time[-1] - STATISTICS_WINDOW_SECONDS]
    force, mean, std = seen.latest
    assert (force, mean) == pytest.approx((values[-1], last.mean()))
    assert std == pytest.approx(last.std(ddof=1), abs=1e-9) if len(last) > 1 else math.isnan(std)


def test_a_monitor_answers_and_shows_forces_rate_and_faults():
    seen = ForceStatistics()
    event = LoadCellFaultEvent(12.25, LoadCellFault.FROZEN, began=False)
    seen.add([ForceSample(0.5, 9.0), *(ForceSample(11.5 + 0.5 * k, 1.0 + 0.01 * k) for k in range(3))], [event])
    answer = monitor_json(seen, STATUS, 10.0)
    assert {key: answer[key] for key in ("reliable", "connected", "samples", "rate")} == {
        "reliable": False, "connected": True, "samples": 3, "rate": 79.96,
    }  # fmt: skip
    assert answer["force"] == {"unit": "N", "mean": pytest.approx(3.0075), "min": 1.0, "max": 9.0, "std": seen.std}
    assert answer["active"] == ["frozen"]
    assert answer["faults"]["malformed"] == 2
    assert answer["events"] == [
        {"time": 2.25, "fault": "frozen", "began": False, "count": 1, "sentence": LoadCellFault.FROZEN.value}
    ]
    assert shown(monitor_table(seen, STATUS, 10.0)) == (
        "force 1.0200 N last second 1.0100 N ± 10.00 mN rate 80.0 Hz, 3 samples "
        f"now {LoadCellFault.FROZEN.value} faults malformed 2 2.25 s frozen is over"
    )


def test_a_calibration_answers_and_shows_its_weights():
    answer = calibration_json(FIT, 80.0)
    assert answer["offset"] == {"value": 84213.44, "std": 1.26, "unit": "count"}
    assert answer["rate"] == 80.0
    assert answer["weights"][1] == {
        "weight": "100 g", "force": 0.981, "counts": -90962.5, "counts_std": 2.0, "noise": 41.0, "residual": -2.5e-5,
        "samples": 59, "outliers": 2,
    }  # fmt: skip
    assert shown(calibration_table(FIT)) == (
        "weight force [N] counts residual [mN] noise [counts] left out 0 g 0.0000 84213.4 ± 1.0 +0.00 40.0 1 "
        "100 g 0.9810 -90962.5 ± 2.0 -0.03 41.0 2 "
        "offset 84213.4 ± 1.3 counts, scale -5.6 ± 0.00023 µN/count, noise 0.22 mN"
    )
