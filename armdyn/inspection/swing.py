r"""Compare a pendulum's recordings with its equations, at a few moments, under every hypothesis on how they were made.

    phi'' = (u cos phi - g sin phi)/l - friction,      T = m (g cos phi + l phi'^2 + u sin phi)

with phi, phi' and phi'' from the smoothed angle or rate, and u from the smoothed pivot. Both are linear in 1/l, m, m l
and the sizes of effects, so that the same evidence serves pendulums and arms.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline
from scipy.signal import detrend

from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.evidence import (
    MIN_MODEL_ERROR_SHARE_OF_RMS,
    ChannelReadings,
    EffectSizes,
    ReadingSums,
    evidence,
    independent_sample_share,
)
from armdyn.inspection.kinematics import local_averages
from armdyn.inspection.mistake import (
    TRIED_SENSOR_LAGS_SECONDS,
    Mistake,
    scaled_channels_mistake,
    shifted_clock_mistakes,
)
from armdyn.inspection.mistakes import (
    ANGLE_ZERO_OFFSETS_TRIED,
    LENGTH_UNITS,
    TRIED_CLOCK_RATE_ERRORS,
    WRONG_ANGLE_UNIT_FACTORS,
)
from armdyn.inspection.together import SampledRuns
from armdyn.model import Model
from armdyn.object_cache import cached_with_first_argument
from armdyn.pendulum.start import swing_channel
from armdyn.run import Run
from armdyn.smoothing.choice import SPLINE_ORDERS, best_smoothing, smooth_curve
from armdyn.smoothing.spline import SplineCurve

SWING_EVALUATION_TIMES = 240
"""Number of moments at which a recording is evaluated."""
OMITTED_EDGE_SHARE_OF_RECORDING = 0.03
"""Share of a recording at either end that is left out, where a smoothed motion is uncertain."""
GUESS_RELATIVE_STD = {"length": 3.0, "mass": 30.0}
"""Relative standard deviation of a guessed value: few pendulums are longer than a metre, and loads have any size."""
MEASURED_RELATIVE_STD = 0.1
"""Relative standard deviation of a value measured by hand, where other effects may be present."""
MAX_SMOOTHED_SAMPLES = 3000
"""Largest number of samples of a channel from which a motion is smoothed."""
WRONG_LOAD_PRICE_NATS, WRONG_LOAD_SHARE_OF_WEIGHT = 30.0, 0.3
"""Price in nats, and share of the load's weight, of an error of the load cell or of another load."""
FORCE_UNITS = {"mN": 1e-3, "gram-force": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216}
"""Force units in N."""
SWING_CLOCK_SHIFTS_TRIED_SECONDS = (-0.5, -0.4, -0.3, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Clock shifts that are tried, s; a smaller delay is an effect, that of a sensor."""
SWING_CLOCK_PRICE_NATS = 2.0
"""Price, in nats, of a wrong clock."""
GRIPPER_SCALE_ERROR_SHARE = 0.05
"""Typical error of a gripper's scale, as a share of its acceleration. With 0.15 it could as well be reversed."""
PENDULUM_MODEL_ERROR_SHARE_OF_RMS = 0.03
"""Model error of a pendulum's equations, as a share of a channel's root mean square: they are known better than an
arm's. A gripper's motion is identified where it causes a tenth of the swing's acceleration, which 0.1 would hide."""
TRIED_STRING_LENGTH_FACTORS, TRIED_SWING_DECAY_RATES = np.linspace(0.8, 1.25, 91), np.array([0.0, 0.02, 0.06, 0.2])
"""Lengths, over the model's, half a percent apart, and decay rates, 1/s, for which a swing that no sensor measures is
simulated. In 30 s the phases of neighbouring lengths differ by half a radian."""
SWING_SIMULATION_STEP_SECONDS = 0.02
"""Step, s, of the simulation of a swing that no sensor measures."""
CORRELATION_LAG_PERIODS = 0.5
"""Time between two moments that show whether a reading is more than noise, in periods of the swing divided by 2 pi."""
SwingMotion = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class SingleChannelReadings:
    """Readings of one channel with a prediction; attributes as of `ChannelReadings`, without the axis of channels."""

    measured: np.ndarray
    described: np.ndarray
    columns: np.ndarray
    positive: np.ndarray
    factor: float
    min_rms: float

    @staticmethod
    def joined(parts: "Sequence[SingleChannelReadings]", weight: np.ndarray, floor: float) -> ChannelReadings:
        """Join channels that have no effects in common."""
        alone = [[(one is own) * one.columns for one in parts] for own in parts]
        lower = np.where(np.concatenate([part.positive for part in parts]), 0.0, -np.inf)
        return ChannelReadings(
            np.array([part.measured for part in parts]),
            np.array([part.described for part in parts]),
            np.array([np.hstack(blocks) for blocks in alone]),
            EffectSizes(np.zeros(len(lower), dtype=int), lower, np.full(len(lower), np.inf)),
            weight,
            np.log(np.abs([part.factor for part in parts])),
            np.array([part.min_rms for part in parts]),
            floor,
        )


@dataclass(frozen=True, eq=False)
class SampledSwingRun:
    """A recording of a pendulum at a few moments, which is compared with the equations of a pendulum.

    Args:
        model: the model of the load.
        run: the recording, without a gap.
    """

    model: Model
    run: Run

    @cached_property
    def swing(self) -> str | None:
        """Name of the channel that measures the swing; None without one."""
        return swing_channel(self.run)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels: the angle, else the rate, and the force."""
        return tuple(name for name in (self.swing, "load_force") if name and name in self.run.channels)

    @cached_property
    def times(self) -> np.ndarray:
        """(n,) moments at which the recording is compared, s."""
        used = [self.run.channels[n] for n in (*self.channels, "gripper_x") if n in self.run.channels]
        begin, end = max(c.time[0] for c in used), min(c.time[-1] for c in used)
        edge = OMITTED_EDGE_SHARE_OF_RECORDING * (end - begin)
        return np.linspace(begin + edge, end - edge, SWING_EVALUATION_TIMES)

    @cached_property
    def _curves(self) -> dict[str, SplineCurve]:
        found: dict[str, SplineCurve] = {}
        for name in (self.swing, "gripper_x"):
            if name is not None and name in self.run.channels:
                whole = self.run.channels[name]
                c = whole.averaged(-(-len(whole) // MAX_SMOOTHED_SAMPLES))
                found[name] = smooth_curve(c.time, c.value, best_smoothing(c.time, c.value, SPLINE_ORDERS[:2]))
        return found

    def _stamps(self, r: CorrectedReading) -> np.ndarray:
        """(n,) stamps of a channel at the moments."""
        return r.stamps_at(self.times, float(self.run.channels[r.source].time[0]))

    @cached_with_first_argument
    def _motion(self, late: float, pace: float) -> SwingMotion:
        """(n,) angle, rate and angular acceleration as recorded, for a delay and a rate error of the stamps."""
        assert self.swing is not None
        time, curve = (
            self._stamps(CorrectedReading(self.swing, delay=late, clock_rate_error=pace)),
            self._curves[self.swing],
        )
        first, second, *third = (
            (1.0 + pace) ** k * curve(time, k)[:, 0] for k in range(3 if self.swing == "swing_angle" else 2)
        )
        if third:
            return first, second, third[0]
        fine = np.linspace(time[0], time[-1], 8 * SWING_EVALUATION_TIMES)
        angle = detrend(cumulative_trapezoid(curve(fine, 0)[:, 0], fine, initial=0.0)) / (1.0 + pace)
        return np.interp(time, fine, angle), first, second

    def _pull(self, r: CorrectedReading) -> np.ndarray:
        """(n,) acceleration of the pivot, m/s^2."""
        if "gripper_x" not in self._curves:
            return np.zeros(SWING_EVALUATION_TIMES)
        return np.asarray(
            r.factor * (1.0 + r.clock_rate_error) ** 2 * self._curves["gripper_x"](self._stamps(r), 2)[:, 0]
        )

    def _force(self, r: CorrectedReading) -> np.ndarray:
        """(n,) force of the load cell, averaged around the moments, N."""
        return r.factor * local_averages(self.run.channels["load_force"], self._stamps(r))

    @cached_with_first_argument
    def _driven(self, factor: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles and rates (d, l, n), for d decay rates and l lengths (l, 1) m, of a load that is at rest at first.

        The gripper moves as recorded, times `factor`.
        """
        gravity, begin, h = (
            self._known("gravity")[0],
            self.run.channels["gripper_x"].time[0],
            SWING_SIMULATION_STEP_SECONDS,
        )
        lengths = self._known("length")[0] * TRIED_STRING_LENGTH_FACTORS
        steps = int((self.times[-1] - begin) / h) + 2
        time = np.minimum(begin + 0.5 * h * np.arange(2 * steps + 1), self.run.channels["gripper_x"].time[-1])
        pull = factor * self._curves["gripper_x"](time, 2)[:, 0]

        def rates(state: np.ndarray, u: float) -> np.ndarray:
            angle, rate = state
            bend = (u * np.cos(angle) - gravity * np.sin(angle)) / lengths - TRIED_SWING_DECAY_RATES[:, None] * rate
            return np.array([rate, bend])

        states = [np.zeros((2, len(TRIED_SWING_DECAY_RATES), len(lengths)))]
        for before, middle, after in zip(pull[:-1:2], pull[1::2], pull[2::2], strict=True):
            state = states[-1]  # Runge-Kutta of order four: a step that adapts takes long where units are wrong
            first = rates(state, before)
            second = rates(state + 0.5 * h * first, middle)
            third = rates(state + 0.5 * h * second, middle)
            last = rates(state + h * third, after)
            states.append(state + h / 6.0 * (first + 2.0 * second + 2.0 * third + last))
        found = make_interp_spline(begin + h * np.arange(steps + 1), states, 1)(self.times)
        return (*np.moveaxis(found, 0, -1), lengths[:, None])

    @cached_property
    def weights(self) -> np.ndarray:
        """(J,) weight of each channel: independent samples over all samples, 1 for white noise."""
        given = self._given(Correction(), np.full(len(self.channels), 0.3))
        soon = CORRELATION_LAG_PERIODS * float(np.sqrt(self._known("length")[0] / self._known("gravity")[0]))
        shifted = Correction({name: CorrectedReading(name, delay=soon) for name in self.run.channels})
        after = self._given(shifted, given.weight).measured
        residual = given.residual(evidence(given.sums).sizes)
        return independent_sample_share(given.measured, residual, given.min_rms, after)

    def corrected(self, correction: Correction) -> "SampledSwingRun":
        """The recording with a correction."""
        return replace(self, run=correction.applied_to(self.run))

    def coarse_log_evidence(self, meanings: Sequence[tuple[Correction, object]]) -> np.ndarray:
        """(h,) log evidence of hypotheses, nats; it is exact, because that of a pendulum is computed fast."""
        return np.array([evidence(self.sums(*meaning)).value for meaning in meanings])

    def sums(self, correction: Correction, description: object = None) -> ReadingSums:
        """What the evidence of a hypothesis needs of this recording, with every effect that may be present."""
        del description  # the equations of a pendulum are known
        return self._sums(tuple(sorted(correction.readings.items())))

    @cached_with_first_argument
    def _sums(self, readings: tuple[tuple[str, CorrectedReading], ...]) -> ReadingSums:
        correction = Correction(dict(readings))
        return replace(self._given(correction, self.weights).sums, log_odds=-self._outside(correction))

    def _outside(self, correction: Correction) -> float:
        """Price in nats of a force with which no string holds this load."""
        if "load_force" not in self.channels:
            return 0.0
        mass, weighed = self._known("mass")
        mean = correction.reading("load_force").factor * float(np.mean(self.run.channels["load_force"].value))
        share = mean / (mass * self._known("gravity")[0])
        other = weighed and not WRONG_LOAD_SHARE_OF_WEIGHT < abs(share) < 1.0 / WRONG_LOAD_SHARE_OF_WEIGHT
        return WRONG_LOAD_PRICE_NATS * (float(share < 0.0) + float(other))

    def _known(self, name: str) -> tuple[float, bool]:
        """SI value of length, mass or gravity, and whether it was measured."""
        known, parameter = self.run.known.get(name), self.model.parameters[name]
        return (known.value, True) if known is not None else (parameter.value, parameter.prior is not None)

    def _width(self, name: str) -> float:
        """Relative standard deviation of length or mass."""
        return MEASURED_RELATIVE_STD if self._known(name)[1] else GUESS_RELATIVE_STD[name]

    def _given(self, correction: Correction, weight: np.ndarray) -> ChannelReadings:
        u = self._pull(correction.reading("gripper_x"))
        if self.swing is None and "gripper_x" in self._curves:
            return SingleChannelReadings.joined(
                [self._force_alone(correction, u)], weight, MIN_MODEL_ERROR_SHARE_OF_RMS
            )
        parts, motion = [], (np.zeros(SWING_EVALUATION_TIMES),) * 3
        if self.swing is not None:
            r = correction.reading(self.swing)
            angle, rate, bend = (r.factor * x for x in self._motion(r.delay, r.clock_rate_error))
            motion = angle + r.offset, rate, bend
            parts.append(self._swing_part(motion, u, r.factor))
        if "load_force" in self.channels:
            parts.append(self._force_part(motion, u, correction.reading("load_force")))
        return SingleChannelReadings.joined(parts, weight, PENDULUM_MODEL_ERROR_SHARE_OF_RMS)

    def _swing_part(self, motion: SwingMotion, u: np.ndarray, factor: float) -> SingleChannelReadings:
        """The angular acceleration, with the effects of a pendulum in their typical sizes."""
        (length, measured), (gravity, _), (angle, rate, bend) = self._known("length"), self._known("gravity"), motion
        drive, pace = u * np.cos(angle) / length, gravity / length
        whole = drive - pace * np.sin(angle)
        columns = [
            self._width("length") * whole, GRIPPER_SCALE_ERROR_SHARE * drive, -0.5 * rate, -np.tanh(20.0 * rate),
            -0.05 * rate * np.abs(rate), 0.05 * pace * np.cos(angle), 0.02 * pace * angle**2,
            0.02 * pace * angle**3, 0.05 * pace * np.linspace(-1.0, 1.0, len(angle)),
        ]  # fmt: skip
        positive = np.array([not measured, False, True, True, True, *([False] * 4)])
        return SingleChannelReadings(bend, measured * whole, np.column_stack(columns), positive, factor, 1e-3 * pace)

    def _force_part(self, motion: SwingMotion, u: np.ndarray, r: CorrectedReading) -> SingleChannelReadings:
        """The force along the string, with the effects of a load cell in their typical sizes."""
        (length, _), (gravity, _), (mass, weighed) = (self._known(name) for name in ("length", "gravity", "mass"))
        angle, rate, _ = motion
        weight = mass * gravity
        parts = mass * (gravity * np.cos(angle) + u * np.sin(angle)), mass * length * rate**2
        bias, aside = np.full(len(angle), 0.1 * weight), 0.03 * weight * np.sin(angle)
        columns = np.column_stack([*(self._width("mass") * part for part in parts), bias, aside])
        positive = np.array([not weighed, not weighed, False, False])
        return SingleChannelReadings(
            self._force(r), weighed * (parts[0] + parts[1]), columns, positive, r.factor, 1e-3 * weight
        )

    def _force_alone(self, correction: Correction, u: np.ndarray) -> SingleChannelReadings:
        """The force in a recording in which it alone measures the swing, of the simulated motion that fits best.

        The mean force determines only the load's weight; so it is left out.
        """
        (mass, weighed), (gravity, _), r = self._known("mass"), self._known("gravity"), correction.reading("load_force")
        y = self._force(r)
        y = y - y.mean()
        angle, rate, length = self._driven(correction.reading("gripper_x").factor)
        shapes = gravity * np.cos(angle) + length * rate**2 + u * np.sin(angle)
        shapes -= shapes.mean(axis=-1, keepdims=True)
        fitting = np.maximum(shapes @ y, 0.0) ** 2 / np.maximum(np.sum(shapes**2, axis=-1), 1e-300)
        j, i = np.unravel_index(np.argmax(fitting), fitting.shape)
        shape, aside = shapes[j, i], np.sin(angle[j, i])
        size = mass if weighed else float(shape @ y) / max(float(shape @ shape), 1e-300)
        longer = shapes[j, min(i + 1, len(TRIED_STRING_LENGTH_FACTORS) - 1)] - shapes[j, max(i - 1, 0)]
        fading = shapes[min(j + 1, len(TRIED_SWING_DECAY_RATES) - 1), i] - shapes[max(j - 1, 0), i]
        columns = [
            self._width("mass") * mass * shape, 0.03 * mass * gravity * (aside - aside.mean()),
            0.02 * mass * gravity * np.linspace(-1.0, 1.0, len(y)), size * longer, size * fading,
        ]  # fmt: skip
        positive = np.array([not weighed, *([False] * 4)])
        return SingleChannelReadings(
            y, weighed * mass * shape, np.column_stack(columns), positive, r.factor, 1e-3 * mass * gravity
        )


def pendulum_mistakes(runs: SampledRuns[SampledSwingRun]) -> Iterator[Mistake]:
    """All possible mistakes in a recording of a pendulum."""
    (run,) = runs.runs  # loads and lengths differ from recording to recording
    has, force = run.run.channels, ("load_force",)
    angular = tuple(name for name in ("swing_angle", "swing_rate") if name in has)
    both, shifts = " and ".join(angular), (*TRIED_SENSOR_LAGS_SECONDS, *SWING_CLOCK_SHIFTS_TRIED_SECONDS)
    for factor, said in WRONG_ANGLE_UNIT_FACTORS if angular else ():
        yield scaled_channels_mistake("angle_unit", angular, f"{both} is in {said}", factor)
    for said, offset in ANGLE_ZERO_OFFSETS_TRIED.items() if run.swing == "swing_angle" else ():
        zero = f"the zero of swing_angle is off by {said}: 0 is hanging"
        yield scaled_channels_mistake("position_offset", ("swing_angle",), zero, offset=-offset)
    if "gripper_x" in has:
        if angular:
            said = f"{both} count the other way than gripper_x: the load is at gripper_x - l sin(angle)"
            yield replace(
                scaled_channels_mistake("position_sign", angular, said, -1.0), channels=(*angular, "gripper_x")
            )
        for unit, factor in {**LENGTH_UNITS, "m, and called mm": 1e3}.items():
            said = f"gripper_x is in {unit}" + ("" if "called" in unit else " and called m")
            yield scaled_channels_mistake("scale", ("gripper_x",), said, factor)
        others = tuple(name for name in has if name != "gripper_x")
        said = "what swings is stamped {} against gripper_x"
        yield from shifted_clock_mistakes(others, said, SWING_CLOCK_PRICE_NATS, shifts, TRIED_CLOCK_RATE_ERRORS)
    if "load_force" in has:
        for unit, factor in FORCE_UNITS.items():
            yield scaled_channels_mistake("torque_unit", force, f"load_force is in {unit} and called N", factor)
        yield scaled_channels_mistake("torque_sign", force, "load_force has the wrong sign: a string pulls", -1.0)
        if angular:
            yield from shifted_clock_mistakes(
                force, "load_force is stamped {} against the swing", SWING_CLOCK_PRICE_NATS, shifts
            )
