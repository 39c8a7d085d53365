"""What is known of a residual that no effect explains."""

import numpy as np
import pytest

from armdyn.identify.fit import Fit
from armdyn.identify.least_squares import Outcome
from armdyn.identify.noise import Whitening
from armdyn.identify.problem import ResidualBlock
from armdyn.identify.residual.character import spectral_peaks
from armdyn.run import Channel


def test_a_joint_that_moved_for_a_handful_of_samples_does_not_hide_the_frequency_of_another_run() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(400) * 0.05

    def block(run: str, samples: int) -> ResidualBlock:
        residual = np.sin(2.0 * np.pi * 1.3 * time[:samples]) * 5.0 + rng.standard_normal(samples)
        return ResidualBlock(
            run, "tau.j", Channel(time[:samples], residual, "N m"), residual, np.zeros((samples, 0)), 1.0
        )

    blocks = (block("long", 400), block("short", 3))
    fit = Fit(None, np.zeros(0, dtype=bool), np.zeros(0), blocks, Outcome.CONVERGED)
    (peak,) = spectral_peaks(fit, {"tau.j": Whitening(np.zeros(3), 1.0)})
    assert peak.frequency == pytest.approx(1.3, rel=0.02)
