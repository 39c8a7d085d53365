"""Prepare an arm's run for comparison: torques are low-passed, and thinned until their noise is white again.

Measured and predicted torques pass the same filter, as in the parallel filtering of Gautier (ICRA 1997), so filtering
causes no bias. Samples at about twice the cut-off contain the whole band. The torque that the positions' noise causes
counts as noise.

Torques are compared up to `MAX_RIGID_LINK_FREQUENCY_HZ` at least, and up to the end of the torque's own band where that
is higher. The band is narrower only where the positions are too noisy, because their noise, differentiated twice and
multiplied by the inertias, grows like f^2 and exceeds the measured torque above some frequency; or where the drive has
smoothed the torque before it was recorded (see `drive`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from armdyn.arm.drive import DriveLowPass, RecordedTorque, TorqueRecording
from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN, MeasuredMotion, measured_motion
from armdyn.arm.rigid import inverse_dynamics, torque_regressor
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, Channel, DriveReading
from armdyn.recording.preparation import Preparation
from armdyn.run import Run
from armdyn.smoothing.choice import MAX_SMOOTHING_CUTOFF_SHARE_OF_RATE, SmoothingChoice, best_smoothing
from armdyn.smoothing.spline import (
    MAX_UNDISTORTED_CUTOFF_PER_KNOT,
    WHITE_RATE_OVER_TWICE_CUTOFF,
    LowPass,
    SplineSamples,
)

MAX_RIGID_LINK_FREQUENCY_HZ = 10.0
"""Frequency up to which the links of arms are stiff (Swevers, Verdonck & De Schutter, IEEE CSM 27, 2007)."""
BAND_SHARE_OF_SMOOTHING_CUTOFF = 0.7
"""End of a torque's own band, as a share of the cut-off of its smoothing, at which the torque equals its noise; at the
end of the band its power is 16 times that of the noise."""
MAX_THINNED_TORQUE_RATE_HZ = 125.0
"""Largest sampling rate of thinned torques, Hz: no arm's rigid-body motion is faster."""
COMPARED_SHARE_OF_DRIVE_CUTOFF = 0.5
"""Highest compared frequency, as a share of the cut-off of a drive's low-pass: there the low-pass has removed 6 % of
the amplitude."""
MIN_KEPT_TORQUE_SAMPLES = 20
"""Least number of samples of a torque that are kept, where so many were recorded."""
INERTIA_AVERAGE_POSTURES = 20
"""Number of postures of a run over which inertias are averaged."""
POSITION_NOISE_FREQUENCIES_HZ = np.linspace(0.0, MAX_THINNED_TORQUE_RATE_HZ / (2.0 * WHITE_RATE_OVER_TWICE_CUTOFF), 701)
"""Frequencies of the spectra of the positions' noise, Hz."""
OMITTED_EDGE_CUTOFF_PERIODS = 0.5
"""Periods of the cut-off that are left out at both ends, where smoothing has neighbours on one side only."""
MAX_GAP_CUTOFF_PERIODS = 0.25
"""Longest gap, in periods of the cut-off, that does not change the low-passed torque."""
MAX_UNEXPLAINED_READING_SHARE = 0.1
"""Share of a drive's reading below which what no physics explains is noise of differentiated positions: 0.003 to 0.013
of generated arms, once 0.06; 0.2 of an SO-101, which has laws that are in no catalogue."""
READING_FRICTION_FADING_SPEEDS = (0.05, 0.15)
"""Speeds of fading frictions, rad/s or m/s; see `Motion.own_columns`."""


def comparison_cutoff(stamps: np.ndarray, torque: np.ndarray, choice: SmoothingChoice, brought_in: np.ndarray) -> float:
    """Cut-off, Hz, of the low-pass that keeps as much torque and as little noise as possible for a comparison.

    It is the f up to `MAX_RIGID_LINK_FREQUENCY_HZ`, or up to the torque's own band, that maximises int_0^f S(f') -
    P(f') df', with S the spectrum of the measured torque and P that of the torque by the positions' noise.

    Args:
        stamps: (n,) time stamps, s.
        torque: (n,) torque, N m or N.
        choice: the best smoothing of the torque, whose cut-off is the end of its own band.
        brought_in: (nf,) spectrum P at `POSITION_NOISE_FREQUENCIES_HZ`; see `torque_spectra_of_position_noise`.
    """
    interval = float((stamps[-1] - stamps[0]) / (len(stamps) - 1))
    as_recorded, per_second = (
        1.0 / interval,
        min(MIN_KEPT_TORQUE_SAMPLES, len(stamps) // 3) / float(stamps[-1] - stamps[0]),
    )
    # Without visible noise up to the highest cut-off that was tried, the end of the band is unknown.
    own_band = (
        BAND_SHARE_OF_SMOOTHING_CUTOFF * choice.cutoff
        if choice.cutoff < 0.99 * MAX_SMOOTHING_CUTOFF_SHARE_OF_RATE / interval
        else 0.0
    )
    widest = min(max(MAX_RIGID_LINK_FREQUENCY_HZ, own_band), float(POSITION_NOISE_FREQUENCIES_HZ[-1]))
    frequencies, measured = _spectrum(stamps, torque, interval)
    frequencies, measured = frequencies[frequencies <= widest], measured[frequencies <= widest]
    last = int(np.argmax(np.cumsum(measured - np.interp(frequencies, POSITION_NOISE_FREQUENCIES_HZ, brought_in))))
    useful = widest if last == len(frequencies) - 1 else float(frequencies[last])
    return min(max(2.0 * WHITE_RATE_OVER_TWICE_CUTOFF * useful, per_second), as_recorded) / (
        2.0 * WHITE_RATE_OVER_TWICE_CUTOFF
    )


def torque_spectra_of_position_noise(
    model: pin.Model, motion: MeasuredMotion, moved: Sequence[int] | None = None
) -> np.ndarray:
    """(nj, nf) spectra, (N m)^2/Hz, of torque by the noise of smoothed positions, at `POSITION_NOISE_FREQUENCIES_HZ`.

    A small error e of the positions changes the torque by M(q) e'' + dg/dq e; squared factors are averaged over the
    run's postures. `moved` are the joints of the model that the motion moves, None for all; others stay at zero.
    """
    data, own = model.createData(), list(range(model.nv) if moved is None else moved)
    squares = np.zeros((model.nv, len(own), len(POSITION_NOISE_FREQUENCIES_HZ)))
    for posture in motion.at(np.linspace(motion.start, motion.end, INERTIA_AVERAGE_POSTURES)).q:
        q = np.zeros(model.nq)
        q[own] = posture
        mass = np.triu(pin.crba(model, data, q).reshape(model.nv, model.nv))
        stiffness = pin.computeGeneralizedGravityDerivatives(model, data, q).reshape(model.nv, model.nv)
        inertial = np.multiply.outer(mass + np.triu(mass, 1).T, (2.0 * np.pi * POSITION_NOISE_FREQUENCIES_HZ) ** 2)
        squares += (stiffness[:, own, None] - inertial[:, own]) ** 2 / INERTIA_AVERAGE_POSTURES
    choices = [j.choice for j in motion.joints]
    passed = [1.0 / (1.0 + (POSITION_NOISE_FREQUENCIES_HZ / c.cutoff) ** (2 * c.order)) ** 2 for c in choices]
    spectra = np.array([j.choice.noise**2 * j.interval for j in motion.joints])[:, None] * np.array(passed)
    return np.asarray(np.einsum("jif,if->jf", squares, spectra))


def _spectrum(stamps: np.ndarray, values: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and two-sided power densities of a signal without its mean, under a Hann window."""
    even = stamps[0] + interval * np.arange(len(stamps))
    window = np.hanning(len(stamps) + 2)[1:-1]
    signal = np.interp(even, stamps, values)
    power = np.abs(np.fft.rfft(window * (signal - np.average(signal, weights=window)))) ** 2
    return np.fft.rfftfreq(len(stamps), interval), interval * power / float(window @ window)


@dataclass(frozen=True, eq=False, repr=False)
class PreparedRun(Run):
    """A run with low-passed and thinned torques; predictions for it are filtered in the same way.

    Its `noise` is that of the thinned torques, estimated where the recording states none.

    Attributes:
        original: the recording.
        processing: processing of each torque, by its channel.
        mostly_resting_joints: whether each joint mostly rests, so that its rests are compared as well.
    """

    original: Run = field(kw_only=True)
    processing: Mapping[str, Preparation] = field(kw_only=True)
    mostly_resting_joints: tuple[bool, ...] = field(kw_only=True)

    @property
    def recording(self) -> Run:
        """The recording from which this run was prepared."""
        return self.original

    @property
    def preparations(self) -> Mapping[str, Preparation]:
        """Processing of each torque, by its channel."""
        return self.processing


@cached_with_first_argument
def motion_of_run(run: Run, joints: tuple[str, ...]) -> MeasuredMotion:
    """The motion of an arm's joints in a run; for a prepared run it is known which joints mostly rest."""
    motion = measured_motion(run.recording, joints)
    return motion.standing(run.mostly_resting_joints) if isinstance(run, PreparedRun) else motion


def recorded_torques(run: Run, model: pin.Model, joints: tuple[str, ...]) -> TorqueRecording:
    """Recorded torques of a run, without those at the ends of its motion, and the motion.

    Raises:
        InputError: a torque is constant or too short.
    """
    motion = measured_motion(run, joints)
    brought_in = torque_spectra_of_position_noise(model, motion)
    torques = {}
    for j, joint in enumerate(joints):
        name = f"tau.{joint}"
        if name in run.channels:
            run.require_varying_channel(name)
            stamps, values = _inside(run, name, motion)
            reading = isinstance(run.channels[name], DriveReading)
            physics = _physics(model, motion, j, stamps) if reading else np.zeros((0, 0))
            torques[name] = RecordedTorque(j, stamps, values, brought_in[j], physics)
    return TorqueRecording(torques, motion)


def recorded_wrench(
    run: Run,
    channels: Sequence[str],
    model: pin.Model,
    motion: MeasuredMotion,
    moved: Sequence[int],
    axes: Sequence[int],
) -> dict[str, RecordedTorque]:
    """Recorded axes of a force/torque sensor, without those at the ends of the motion.

    Args:
        run: a recording.
        channels: names of the six channels, of which the recording may lack some.
        model: the arm, cut at the sensor; see `armdyn.arm.wrench.sensor`.
        motion: the motion of the arm.
        moved: joints of `model` that the motion moves.
        axes: joints of `model` that stand for the six axes.

    Raises:
        InputError: a channel is constant or too short.
    """
    brought_in = torque_spectra_of_position_noise(model, motion, moved)[list(axes)]
    found = {}
    for name, spectrum in zip(channels, brought_in, strict=True):
        if name in run.channels:
            run.require_varying_channel(name)
            found[name] = RecordedTorque(None, *_inside(run, name, motion), spectrum, np.zeros((0, 0)))
    return found


def low_passed_and_thinned(
    run: Run,
    joints: tuple[str, ...],
    own: TorqueRecording,
    drives: Mapping[str, DriveLowPass],
    standing: Sequence[bool],
) -> PreparedRun:
    """The run with low-passed and thinned torques, and with smoothed motion.

    Args:
        run: a recording.
        joints: all joints of the arm, in its order.
        own: recorded torques and motion of the recording.
        drives: low-passes of the drives; see `smoothing_drives`.
        standing: whether each joint mostly rests in all recordings together.
    """
    # At rest a drive's reading is held by friction of any size, up to breakaway.
    reading = [isinstance(run.channels.get(f"tau.{joint}"), DriveReading) for joint in joints]
    stands = [still and not reads for still, reads in zip(standing, reading, strict=True)]
    motion = own.motion.standing(stands)
    channels, noise, preparations, at_rest = dict(run.channels), dict(run.noise), {}, set[str]()
    for name, (j, stamps, values, brought_in, physics) in own.torques.items():
        raw, choice = run.channels[name], best_smoothing(stamps, values)
        cutoff = comparison_cutoff(stamps, values, choice, brought_in)
        drive = drives.get(name, DriveLowPass(np.inf, choice.noise))
        smoothed = bool(np.isfinite(drive.cutoff))
        cutoff = min(cutoff, COMPARED_SHARE_OF_DRIVE_CUTOFF * drive.cutoff)
        if j is not None and isinstance(raw, DriveReading):
            cutoff = min(cutoff, motion.joints[j].choice.cutoff)
        known = samples_with_known_direction(motion, j, stamps, cutoff)
        time = _thinned(stamps, known, cutoff)
        if (
            j is not None and len(time) < MIN_COMPARED_CHANNEL_SAMPLES and not stands[j]
        ):  # it moves in other recordings only
            stands[j] = True
            at_rest.add(name)
            motion = motion.standing(stands)
            known = samples_with_known_direction(motion, j, stamps, cutoff)
            time = _thinned(stamps, known, cutoff)
        low = LowPass(SplineSamples(stamps[known], MAX_UNDISTORTED_CUTOFF_PER_KNOT / cutoff), cutoff)
        channels[name] = Channel(time, low.curve(values[known])(time)[:, 0], raw.unit)
        # The noise is that of the recording at its own rate, because thinned samples vary too much to show it. To a
        # smooth curve steps of friction look like noise; behind a low-pass there is more noise than samples show.
        sensor = run.noise.get(name) or (drive.noise if smoothed else min(drive.noise, choice.noise))
        noise[name] = float(np.sqrt(low.noise_gain(time) * sensor**2 + _below(cutoff, brought_in)))
        if isinstance(raw, DriveReading):
            left = _unexplained(low.curve(physics[known])(time), channels[name].value)
            if left < MAX_UNEXPLAINED_READING_SHARE * float(np.std(values)):
                noise[name] = float(np.hypot(max(noise[name], left), raw.common_error_std))
        preparations[name] = Preparation(
            cutoff=cutoff,
            position_cutoff=min(p.choice.cutoff for p in (motion.joints if j is None else [motion.joints[j]])),
            rate=float(1.0 / np.median(np.diff(time))),
            samples=len(time),
            recorded_rate=float((len(raw) - 1) / (raw.time[-1] - raw.time[0])),
            recorded=len(raw),
            left_out=float(np.mean(~known)),
            moving=1.0
            if j is None
            else float(np.mean(np.abs(motion.direction(j, stamps)) >= MIN_CERTAIN_VELOCITY_SIGN)),
            smoothed=drive.cutoff if smoothed else None,
        )
    for name in at_rest if at_rest != set(preparations) else ():
        del channels[name], preparations[name]
    for joint, path in zip(joints, motion.joints, strict=True):
        q = run.channels[f"q.{joint}"]
        for k, (kind, per) in enumerate((("q", ""), ("v", "/s"), ("a", "/s^2"))):
            channels[f"{kind}.{joint}"] = Channel(q.time, path.curve(q.time, k)[:, 0], f"{q.unit}{per}")
    return PreparedRun(
        run.name, channels, run.known, noise, run.description, run.source, run.warnings,
        original=run, processing=preparations, mostly_resting_joints=tuple(stands), outliers=run.outliers,
        extra=run.extra,
    )  # fmt: skip


def torque_noise(
    run: PreparedRun,
    arm: pin.Model,
    described: pin.Model,
    joints: tuple[str, ...],
    channels: Mapping[str, int],
    moved: Sequence[int] | None = None,
) -> dict[str, float]:
    """Noise of a prepared run by channel, for an arm with other inertias than were described.

    Args:
        run: a prepared run.
        arm: the present arm.
        described: the arm for which the run was prepared.
        joints: all joints of the arm, in its order.
        channels: joint of both models whose torque each channel is.
        moved: joints of both models that the recording moves, None for all.
    """
    motion = measured_motion(run.recording, joints)
    before, after = (torque_spectra_of_position_noise(model, motion, moved) for model in (described, arm))
    found = {}
    for name, j in channels.items():
        cutoff = run.preparations[name].cutoff
        more = _below(cutoff, after[j]) - _below(cutoff, before[j])
        found[name] = float(np.sqrt(max(run.noise[name] ** 2 + more, 0.0)))
    return found


def _physics(model: pin.Model, motion: MeasuredMotion, joint: int, stamps: np.ndarray) -> np.ndarray:
    """(n, 15) regression columns of a joint's torque: load, unknown payload, springs, rotor, frictions of all kinds."""
    at = motion.at(stamps)
    load = inverse_dynamics(model, at.q, at.v, at.a)[:, joint]
    carried = torque_regressor(model, at.q, at.v, at.a)[:, joint, -1, :4]
    friction = at.direction[:, joint] * np.abs(load)
    return np.column_stack([load, carried, *at.own_columns(joint, READING_FRICTION_FADING_SPEEDS), friction])


def _unexplained(physics: np.ndarray, reading: np.ndarray) -> float:
    """Standard deviation of the residual of (n,) readings after a regression on (n, k) columns."""
    size = np.maximum(np.linalg.norm(physics, axis=0), 1e-12)
    found, _, rank, _ = np.linalg.lstsq(physics / size, reading, rcond=1e-9)
    left = reading - physics / size @ found
    return float(np.sqrt(left @ left / max(len(reading) - rank, 1)))


def _below(cutoff: float, spectrum: np.ndarray) -> float:
    """Variance of a signal with a two-sided spectrum (nf,) at `POSITION_NOISE_FREQUENCIES_HZ`, below a cut-off, Hz."""
    return 2.0 * float(np.sum(spectrum[cutoff >= POSITION_NOISE_FREQUENCIES_HZ]) * POSITION_NOISE_FREQUENCIES_HZ[1])


def samples_inside_motion(channel: Channel, motion: MeasuredMotion) -> np.ndarray:
    """(n,) bool, whether each sample is within the recorded motion, but not at its ends.

    At an end a smoothed acceleration has neighbours on one side only, and a several times larger standard deviation.
    """
    edge = OMITTED_EDGE_CUTOFF_PERIODS * max(1.0 / j.choice.cutoff for j in motion.joints)
    edge = min(edge, 0.1 * (motion.end - motion.start))
    return (channel.time >= motion.start + edge) & (channel.time <= motion.end - edge)


def _inside(run: Run, name: str, motion: MeasuredMotion) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and values of a torque without the ends of the motion.

    Raises:
        InputError: there the torque is constant, or there is hardly any of it.
    """
    raw = run.channels[name]
    keep = samples_inside_motion(raw, motion)
    if not np.any((raw.time >= motion.start) & (raw.time <= motion.end)):
        raise InputError(
            f"{run.source or run.name}: '{name}', from {raw.time[0]:g} to {raw.time[-1]:g} s, and the positions, from "
            f"{motion.start:g} to {motion.end:g} s, were not recorded together: record them in one run"
        )
    if np.count_nonzero(keep) < MIN_COMPARED_CHANNEL_SAMPLES:
        raise InputError(
            f"{run.source or run.name}: '{name}' has {np.count_nonzero(keep)} samples while the joints' positions were "
            f"recorded, without the ends, at least {MIN_COMPARED_CHANNEL_SAMPLES} are needed: record longer"
        )
    inside = raw.selected(keep)
    replace(run, channels={name: inside}).require_varying_channel(name)
    return inside.time, inside.value


def samples_with_known_direction(
    motion: MeasuredMotion, joint: int | None, stamps: np.ndarray, cutoff: float
) -> np.ndarray:
    """(n,) bool, whether the direction of motion is known at each sample, or a joint that mostly rests is at rest.

    Where a joint reverses, its dry friction changes sign at an uncertain moment: one sample of a friction of 25 times
    the noise, with the wrong sign, is an error of 3 standard deviations after the low-pass. These few samples are left
    out of the measured and of the predicted torque. At rest friction takes any value up to breakaway, so rests are left
    out as well, however long they are, except those of a joint that hardly moves in any recording.
    """
    if joint is None:  # a wrench has no friction
        return np.ones(len(stamps), dtype=bool)
    uncertain = np.abs(motion.direction(joint, stamps)) < MIN_CERTAIN_VELOCITY_SIGN
    if not motion.joints[joint].mostly_rests:
        return ~uncertain
    edges = np.flatnonzero(np.diff(np.concatenate([[False], uncertain, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        if stamps[end - 1] - stamps[begin] > MAX_GAP_CUTOFF_PERIODS / cutoff:
            uncertain[begin:end] = False
    return ~uncertain


def _thinned(stamps: np.ndarray, known: np.ndarray, cutoff: float) -> np.ndarray:
    """Even times for a signal with this cut-off, without those in gaps of the `known` stamps and beside long gaps.

    Beside a long gap, such as a rest, a smoothed torque has neighbours on one side only, as at the ends.
    """
    step = 1.0 / (2.0 * WHITE_RATE_OVER_TWICE_CUTOFF * cutoff)
    usual = float(np.median(np.diff(stamps)))
    stamps = stamps[known]
    if len(stamps) < 2:
        return stamps[:0]
    edge = min(OMITTED_EDGE_CUTOFF_PERIODS / cutoff, 0.1 * (stamps[-1] - stamps[0]))
    first, last = stamps[0] + edge, stamps[-1] - edge
    count = int((last - first) / step)
    time = first + (last - first - count * step) / 2.0 + step * np.arange(count + 1)
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    nearest = np.minimum(np.abs(time - stamps[after - 1]), np.abs(stamps[after] - time))
    time = time[nearest <= step / 2.0]
    long = np.flatnonzero(np.diff(stamps) > usual + OMITTED_EDGE_CUTOFF_PERIODS / cutoff)
    beside = np.zeros(len(time), dtype=bool)
    for begin, end in zip(stamps[long] - edge, stamps[long + 1] + edge, strict=True):
        beside |= (time > begin) & (time < end)
    return time[~beside]
