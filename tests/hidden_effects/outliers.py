"""Samples that a sensor or a bus spoiled: far off, isolated, at random."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from armdyn.run import Channel, Run

SMALLEST, LARGEST = {"N": 0.1, "N m": 1.0, "m": 0.005, "rad": 0.01}, {"N": 50.0, "N m": 50.0, "m": 0.5, "rad": 6.3}
"""How far off, by unit: evenly drawn over the logarithm between the two."""


def spoilt(run: Run, channels: Iterable[str], share: float, seed: int) -> Run:
    """The run with this share of the samples of some channels off by anything, to either side."""
    rng, spoilt = np.random.default_rng(seed), dict(run.channels)
    for name in channels:
        channel = run.channels[name]
        value, bad = channel.value.copy(), rng.random(len(channel)) < share
        low, high = np.log([SMALLEST[channel.unit], LARGEST[channel.unit]])
        value[bad] += rng.choice([-1.0, 1.0], bad.sum()) * np.exp(rng.uniform(low, high, bad.sum()))
        spoilt[name] = Channel(channel.time, value, channel.unit)
    return replace(run, channels=spoilt)
