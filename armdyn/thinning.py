"""Recordings whose sampling rate is far above their bandwidth."""

from dataclasses import replace

import numpy as np

from armdyn.run import Channel, Run

HIGHEST_RATE = 125.0
"""Hz; what is sampled faster is averaged in groups: a swing has no signal above."""


def thinned(run: Run, highest_rate: float = HIGHEST_RATE) -> Run:
    """The run with channels that were sampled faster averaged in groups, at the groups' mean times.

    Averaging k samples shifts nothing in time and lowers white noise by sqrt(k).
    """
    channels, noise = {}, dict(run.noise)
    for name, channel in run.channels.items():
        interval = float(np.median(np.diff(channel.time))) if len(channel) > 1 else np.inf
        group = int(1.0 / (highest_rate * interval) + 1e-6) if interval > 0 else 1
        if group < 2 or len(channel) < 4 * group:
            channels[name] = channel
            continue
        n = len(channel) // group * group
        time, value = (a[:n].reshape(-1, group).mean(axis=1) for a in (channel.time, channel.value))
        channels[name] = Channel(time, value, channel.unit)
        if name in noise:
            noise[name] /= np.sqrt(group)
    return replace(run, channels=channels, noise=noise)
