"""A run in pieces where nobody saw what the gripper did: each has a start of its own."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from armdyn.channels import MIN_SAMPLES, Channel
from armdyn.run import Run

BLIND = 0.25
"""s without a position of the gripper over which a spline still tells where it was: motions of up to 1.5 Hz to 2 %."""
STILL = 1e-3
"""m that the gripper is displaced around a gap in which it rested."""


def pieces(run: Run) -> tuple[Run, ...]:
    """The run, cut where the gripper moved unseen; `Run.warnings` says so, and `Run.began` keeps the time."""
    gripper = run.channels.get("gripper_x")
    if gripper is None:
        return (run,)
    before = np.flatnonzero(np.diff(gripper.time) > BLIND)
    before = before[[_moved(gripper, int(i)) for i in before]] if len(before) else before
    if not len(before):
        return (run,)
    starts = [-np.inf, *gripper.time[before + 1]]
    ends = [*gripper.time[before], np.inf]
    parts = [_between(run, start, end) for start, end in zip(starts, ends, strict=True)]
    whole = [channels for channels in parts if min(len(channel) for channel in channels.values()) >= MIN_SAMPLES]
    gaps = ", ".join(f"from {gripper.time[i]:.4g} to {gripper.time[i + 1]:.4g} s" for i in before)
    said = f"gripper_x: it moved while no position was recorded, {gaps}; what follows is a run of its own"
    began = min(float(channel.time[0]) for channel in run.channels.values())
    return tuple(
        replace(
            run, name=f"{run.name}#{k}", channels=channels, began=began,
            warnings=(*run.warnings, said) if k == 1 else (),
        )
        for k, channels in enumerate(whole, start=1)
    )  # fmt: skip


def _moved(gripper: Channel, before: int) -> bool:
    """Whether the gripper moved around the gap that follows sample `before`."""
    near = (gripper.time > gripper.time[before] - BLIND) & (gripper.time < gripper.time[before + 1] + BLIND)
    return bool(np.ptp(gripper.value[near]) > STILL)


def _between(run: Run, start: float, end: float) -> Mapping[str, Channel]:
    return {
        name: Channel(c.time[inside], c.value[inside], c.unit)
        for name, c in run.channels.items()
        for inside in [(c.time >= start) & (c.time <= end)]
    }
