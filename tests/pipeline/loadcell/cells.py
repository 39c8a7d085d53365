"""A calibration for tests that need one, whatever it is."""

from datetime import UTC, datetime

from pipeline.loadcell.calibration import Calibration


def calibration(offset=1000.0, scale=1e-4, noise=4e-3):
    return Calibration(offset, 1.0, scale, 1e-10, noise, datetime(2026, 3, 2, tzinfo=UTC), "test")
