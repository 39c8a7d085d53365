"""What is worked out once per recording and kept, whatever the effects and parameters of the model."""

from functools import lru_cache

import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import Stretch
from armdyn.arm.motion import measured_motion
from armdyn.arm.prediction import ChannelPredictor
from armdyn.arm.prepared import PreparedRun, interior, prepare, settled
from armdyn.faults import without_spikes
from armdyn.readout import Interpolated, LowPassed, Sampler
from armdyn.run import Channel, Run


@lru_cache(maxsize=64)
def prepared(run: Run, arm: Arm, measured: tuple[str, ...]) -> PreparedRun:
    """See `prepare`; isolated outliers are left out before."""
    motion = (f"{kind}.{joint}" for joint in arm.joints for kind in "qva")
    clean = without_spikes(run, (*(name for name in motion if name in run.channels), *measured))
    return prepare(clean, arm.model, arm.joints, measured)


@lru_cache(maxsize=512)
def predictor(arm: Arm, run: Run, channel: Channel, name: str) -> ChannelPredictor:
    """What predicts the samples of a torque channel called `name`; filtered as the run was, where it was."""
    joint = arm.joints.index(name.removeprefix("tau."))
    sampler: Sampler
    if run.recording is not run:
        stretch = _stretch(run.recording, arm, name, True)
        stamps, cutoff = stretch.motion.time, run.preparations[name].cutoff
        known = settled(measured_motion(run.recording, arm.joints), joint, stamps, cutoff)
        sampler = LowPassed(stamps, cutoff, channel.time, known)
    else:
        stretch = _stretch(run, arm, name, False)
        sampler = Interpolated(channel.time, channel.time)
    return ChannelPredictor(stretch, sampler, joint)


@lru_cache(maxsize=64)
def _stretch(run: Run, arm: Arm, name: str, without_ends: bool) -> Stretch:
    """The motion at the stamps of a channel; channels that were sampled together share it."""
    channel = run.channels[name]
    for other in run.channels:
        if other == name:
            break
        if other.startswith("tau.") and np.array_equal(run.channels[other].time, channel.time):
            return _stretch(run, arm, other, without_ends)
    motion = measured_motion(run, arm.joints)
    time = channel.time[interior(channel, motion)] if without_ends else channel.time
    start = min(float(c.time[0]) for c in run.channels.values())
    return Stretch(arm.model, motion.at(time), time - start)
