r"""Compare a pendulum's recordings with its equations, at a few moments, under every hypothesis on how they were made.

    phi'' = (u cos phi - g sin phi)/l - friction,      T = m (g cos phi + l phi'^2 + u sin phi)

with phi, phi' and phi'' from the smoothed angle or rate, and u from the smoothed pivot. Both are linear in 1/l, m, m l
and the sizes of effects, so that the same evidence serves pendulums and arms.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from armdyn.inspection.correction import Correction, Reading
from armdyn.inspection.evidence import MODEL_ERROR_FLOOR, Channels, Evidence, evidence, independent
from armdyn.inspection.hypotheses import (
    CLOCK_RATE_ERRORS,
    LENGTH_UNITS,
    RAD_PER_DEGREE,
    ZERO_OFFSETS,
    Hypothesis,
    read_as,
    stamped,
    stamps,
)
from armdyn.inspection.kinematics import averages
from armdyn.model import Model
from armdyn.run import Run
from armdyn.smoothing import SPLINE_ORDERS, Curve, best_smoothing, smoothed

SWING_MOMENTS = 240
"""Number of moments at which a recording is evaluated."""
GUESS_RELATIVE_STD = {"length": 3.0, "mass": 30.0}
"""Relative standard deviation of a guessed value: few pendulums are longer than a metre, and loads have any size."""
MEASURED_RELATIVE_STD = 0.1
"""Relative standard deviation of a value measured by hand, where other effects may be present."""
MAX_SMOOTHED_SAMPLES = 3000
"""Largest number of samples of a channel from which a motion is smoothed."""
WRONG_LOAD_PRICE_NATS, WRONG_LOAD_SHARE = 30.0, 0.3
"""Price in nats, and share of the load's weight, of an error of the load cell or of another load."""
FORCE_UNITS = {"mN": 1e-3, "gram-force": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216}
"""Force units in N."""
SWING_CLOCK_SHIFTS = (-0.5, -0.4, -0.3, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Clock shifts that are tried, s; a smaller delay is an effect, that of a sensor."""
GRIPPER_SCALE_ERROR = 0.05
"""Typical error of a gripper's scale, as a share of its acceleration. With 0.15 it could as well be reversed."""
PENDULUM_MODEL_ERROR = 0.03
"""Model error of a pendulum's equations, as a share of a channel's root mean square: they are known better than an
arm's. A gripper's motion is identified where it causes a tenth of the swing's acceleration, which 0.1 would hide."""
LENGTH_FACTORS, DECAY_RATES = np.linspace(0.8, 1.25, 91), np.array([0.0, 0.02, 0.06, 0.2])
"""Lengths, over the model's, half a percent apart, and decay rates, 1/s, for which a swing that no sensor measures is
simulated. In 30 s the phases of neighbouring lengths differ by half a radian.
"""
MOMENT_SPACING_PERIODS = 0.5
"""Time between two moments that show whether a reading is more than noise, in periods over 2 pi."""
SWING_STEP_SECONDS = 0.02
"""Step of the integration of such a swing, s."""
_TREND = np.linspace(-1.0, 1.0, SWING_MOMENTS)
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class SwingRun:
    """One recording of a pendulum at a few moments.

    Args:
        model: the model of the load.
        run: the recording, without a gap.
    """

    model: Model
    run: Run

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """The compared channels: the angle (or else the rate), and the force."""
        swing = next((n for n in ("swing_angle", "swing_rate") if n in self.run.channels), None)
        return (*((swing,) if swing else ()), *(("load_force",) if "load_force" in self.run.channels else ()))

    @property
    def swing(self) -> str | None:
        """The channel that measures the swing; None where there is none."""
        return self.channels[0] if self.channels and self.channels[0] != "load_force" else None

    @cached_property
    def moments(self) -> np.ndarray:
        """(n,) moments, s."""
        used = [self.run.channels[n] for n in (*self.channels, "gripper_x") if n in self.run.channels]
        begin, end = max(c.time[0] for c in used), min(c.time[-1] for c in used)
        edge = 0.03 * (end - begin)
        return np.linspace(begin + edge, end - edge, SWING_MOMENTS)

    @cached_property
    def _curves(self) -> dict[str, Curve]:
        found: dict[str, Curve] = {}
        for name in ("swing_angle", "swing_rate", "gripper_x"):
            if name in self.run.channels and name in (self.swing, "gripper_x"):
                whole = self.run.channels[name]
                c = whole.averaged(-(-len(whole) // MAX_SMOOTHED_SAMPLES))
                found[name] = smoothed(c.time, c.value, best_smoothing(c.time, c.value, SPLINE_ORDERS[:2]))
        return found

    @cached_property
    def motion(self) -> Callable[[float, float], Motion]:
        """Cached (n,) angle, rate and angular acceleration, for a delay and a rate error of the stamps."""
        return cache(self._motion)

    def _stamps(self, channel: str, late: float, pace: float) -> np.ndarray:
        """(n,) stamps of a channel at the moments."""
        begin = float(self.run.channels[channel].time[0])
        return Reading(channel, late=late, pace=pace).stamped(self.moments, begin)

    def _motion(self, late: float, pace: float) -> Motion:
        time = self._stamps(self.swing or "", late, pace)
        curve = self._curves[self.swing or ""]
        if self.swing == "swing_angle":
            angle, rate, bend = ((1.0 + pace) ** k * curve(time, k)[:, 0] for k in range(3))
            return angle, rate, bend
        rate, bend = ((1.0 + pace) ** k * curve(time, k)[:, 0] for k in range(2))
        fine = np.linspace(time[0], time[-1], 8 * SWING_MOMENTS)
        values = curve(fine, 0)[:, 0]
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(fine))]) / (1.0 + pace)
        angle -= np.polyval(np.polyfit(fine, angle, 1), fine)
        return np.interp(time, fine, angle), rate, bend

    def pull(self, late: float, pace: float = 0.0) -> np.ndarray:
        """(n,) acceleration of the pivot as recorded, m/s^2."""
        if "gripper_x" not in self._curves:
            return np.zeros(SWING_MOMENTS)
        stamps = self._stamps("gripper_x", late, pace)
        return np.asarray((1.0 + pace) ** 2 * self._curves["gripper_x"](stamps, 2)[:, 0])

    def force(self, late: float, pace: float = 0.0) -> np.ndarray:
        """(n,) force of the load cell as recorded, averaged around the moments."""
        return averages(self.run.channels["load_force"], self._stamps("load_force", late, pace))

    @cached_property
    def driven(self) -> Callable[[float], list[Motion]]:
        """Simulated motions of a load, at rest at first, under a scaled gripper motion, by length and decay rate."""
        return cache(self._driven)

    def _driven(self, factor: float) -> list[Motion]:
        gravity, begin = self._known("gravity")[0], float(self.run.channels["gripper_x"].time[0])
        h = SWING_STEP_SECONDS
        steps = int((self.moments[-1] - begin) / h) + 2
        fine = begin + 0.5 * h * np.arange(2 * steps + 1)
        u = factor * self._curves["gripper_x"](np.minimum(fine, self.run.channels["gripper_x"].time[-1]), 2)[:, 0]
        length, fade = (x.ravel() for x in np.meshgrid(self._known("length")[0] * LENGTH_FACTORS, DECAY_RATES))

        def rates(angle: np.ndarray, rate: np.ndarray, u: float) -> tuple[np.ndarray, np.ndarray]:
            return rate, (u * np.cos(angle) - gravity * np.sin(angle)) / length - fade * rate

        found = np.zeros((steps + 1, 2, len(length)))
        a, b = found[0]
        for k in range(steps):
            first = rates(a, b, u[2 * k])
            second = rates(a + 0.5 * h * first[0], b + 0.5 * h * first[1], u[2 * k + 1])
            third = rates(a + 0.5 * h * second[0], b + 0.5 * h * second[1], u[2 * k + 1])
            last = rates(a + h * third[0], b + h * third[1], u[2 * k + 2])
            a = a + h / 6.0 * (first[0] + 2.0 * second[0] + 2.0 * third[0] + last[0])
            b = b + h / 6.0 * (first[1] + 2.0 * second[1] + 2.0 * third[1] + last[1])
            found[k + 1] = a, b
        at = np.clip((self.moments - begin) / h, 0.0, steps - 1e-9)
        i, part = at.astype(int), (at % 1.0)[:, None]
        angle, rate = (((1.0 - part) * found[i, j] + part * found[i + 1, j]).T for j in (0, 1))
        return [(a, r, np.full(len(a), own)) for a, r, own in zip(angle, rate, length, strict=True)]

    @cached_property
    def weights(self) -> np.ndarray:
        """(J,) independent samples per sample."""
        given = self._given(Correction(), np.full(len(self.channels), 0.3))
        soon = MOMENT_SPACING_PERIODS * float(np.sqrt(self._known("length")[0] / self._known("gravity")[0]))
        shifted = Correction({name: Reading(name, late=soon) for name in self.run.channels})
        after = self._given(shifted, given.weight).measured
        return independent(given.measured, evidence(given).left, given.least, after)

    def rough(self, meanings: Sequence[tuple[Correction, object]]) -> np.ndarray:
        """(h,) evidence as in `sure`: a pendulum has few effects, so that no faster method is needed."""
        return np.array([self.sure(*meaning).value for meaning in meanings])

    def sure(self, correction: Correction, description: object = None) -> Evidence:
        """Evidence of a hypothesis, with every effect that may be present."""
        del description
        given = self._given(correction, self.weights)
        found = evidence(given)
        return replace(found, value=found.value - self._outside(correction))

    def _outside(self, correction: Correction) -> float:
        """Price in nats of a force with which no string holds this load."""
        if "load_force" not in self.channels:
            return 0.0
        mass, weighed = self._known("mass")
        mean = correction.reading("load_force").factor * float(np.mean(self.run.channels["load_force"].value))
        share = mean / (mass * self._known("gravity")[0])
        return WRONG_LOAD_PRICE_NATS * (
            float(share < 0.0) + float(weighed and not WRONG_LOAD_SHARE < abs(share) < 1.0 / WRONG_LOAD_SHARE)
        )

    def nothing(self) -> float:
        """Evidence of equations that explain nothing; zero, because a pendulum's equations are known."""
        return -np.inf

    def with_run(self, run: Run) -> "SwingRun":
        """The same model and moments for another recording."""
        return replace(self, run=run)

    def _known(self, name: str) -> tuple[float, bool]:
        """SI value of length, mass or gravity, and whether it was measured."""
        known, parameter = self.run.known.get(name), self.model.parameters[name]
        return (known.value, True) if known is not None else (parameter.value, parameter.prior is not None)

    def _given(self, correction: Correction, weight: np.ndarray) -> Channels:
        n = len(self.moments)
        rows, described, columns, volume, least = [], [], [], [], []
        signs: list[np.ndarray] = []
        angle, rate, bend = np.zeros(n), np.zeros(n), np.zeros(n)
        (length, measured), (gravity, _) = self._known("length"), self._known("gravity")
        u = np.zeros(n)
        if "gripper_x" in self._curves:
            r = correction.reading("gripper_x")
            u = r.factor * self.pull(r.late, r.pace)
            if self.swing is None:
                return self._given_by_force(correction, weight, u)
        if self.swing is not None:
            r = correction.reading(self.swing)
            angle, rate, bend = (r.factor * x for x in self.motion(r.late, r.pace))
            angle = angle + r.offset
            drive, weightless = u * np.cos(angle) / length, -gravity * np.sin(angle) / length
            width = MEASURED_RELATIVE_STD if measured else GUESS_RELATIVE_STD["length"]
            pace = gravity / length
            rows.append(bend)
            described.append((drive + weightless) if measured else np.zeros(n))
            X = [
                width * (drive + weightless), GRIPPER_SCALE_ERROR * drive, -0.5 * rate, -np.tanh(20.0 * rate),
                -0.05 * rate * np.abs(rate), 0.05 * pace * np.cos(angle), 0.02 * pace * angle**2,
                0.02 * pace * angle**3, 0.05 * pace * np.linspace(-1.0, 1.0, n),
            ]  # fmt: skip
            columns.append(np.column_stack(X))
            signs.append(np.array([not measured, False, True, True, True, *([False] * 4)]))
            volume.append(np.log(abs(r.factor)))
            least.append(1e-3 * gravity / length)
        if "load_force" in self.channels:
            r = correction.reading("load_force")
            mass, weighed = self._known("mass")
            width = MEASURED_RELATIVE_STD if weighed else GUESS_RELATIVE_STD["mass"]
            static = gravity * np.cos(angle) + u * np.sin(angle)
            rows.append(r.factor * self.force(r.late, r.pace))
            described.append(mass * (static + length * rate**2) if weighed else np.zeros(n))
            X = [
                width * mass * static,
                width * mass * length * rate**2,
                np.full(n, 0.1 * mass * gravity),
                0.03 * mass * gravity * np.sin(angle),
            ]
            columns.append(np.column_stack(X))
            signs.append(np.array([not weighed, not weighed, *([False] * 2)]))
            volume.append(np.log(abs(r.factor)))
            least.append(1e-3 * mass * gravity)
        width_of = [c.shape[1] for c in columns]
        whole = np.zeros((len(rows), n, sum(width_of)))
        for k, c in enumerate(columns):
            whole[k, :, sum(width_of[:k]) : sum(width_of[: k + 1])] = c
        return Channels(
            np.array(rows),
            np.array(described),
            whole,
            np.concatenate(signs),
            weight,
            np.array(volume),
            np.array(least),
            PENDULUM_MODEL_ERROR,
        )

    def _given_by_force(self, correction: Correction, weight: np.ndarray, u: np.ndarray) -> Channels:
        """Channels for a recording in which only the force measures the swing, of the simulated motion that fits best.

        The mean force determines only the load's weight; so it is left out.
        """
        (mass, weighed), (gravity, _) = self._known("mass"), self._known("gravity")
        r = correction.reading("load_force")
        y = r.factor * self.force(r.late, r.pace)
        y = y - y.mean()
        swings = self.driven(correction.reading("gripper_x").factor)
        shapes = np.array([gravity * np.cos(a) + length * rate**2 + u * np.sin(a) for a, rate, length in swings])
        shapes -= shapes.mean(axis=1, keepdims=True)
        along = np.maximum(shapes @ y, 0.0) ** 2 / np.maximum(np.sum(shapes**2, axis=1), 1e-300)
        best = int(np.argmax(along))
        shape, aside = shapes[best], np.sin(swings[best][0])
        around = shapes.reshape(len(DECAY_RATES), len(LENGTH_FACTORS), -1)
        j, i = divmod(best, len(LENGTH_FACTORS))
        size = mass if weighed else float(shape @ y) / max(float(shape @ shape), 1e-300)
        longer = around[j, min(i + 1, len(LENGTH_FACTORS) - 1)] - around[j, max(i - 1, 0)]
        fading = around[min(j + 1, len(DECAY_RATES) - 1), i] - around[max(j - 1, 0), i]
        width = MEASURED_RELATIVE_STD if weighed else GUESS_RELATIVE_STD["mass"]
        X = [
            width * mass * shape, 0.03 * mass * gravity * (aside - aside.mean()), 0.02 * mass * gravity * _TREND,
            size * longer, size * fading,
        ]  # fmt: skip
        return Channels(
            y[None], (mass * shape if weighed else np.zeros(len(y)))[None], np.column_stack(X)[None],
            np.array([not weighed, *([False] * 4)]), weight, np.array([np.log(abs(r.factor))]),
            np.array([1e-3 * mass * gravity]), MODEL_ERROR_FLOOR,
        )  # fmt: skip


def mistakes(run: SwingRun) -> Iterator[Hypothesis]:
    """Hypotheses on the mistakes in recordings of pendulums."""
    has, force = run.run.channels, ("load_force",)
    angular = tuple(n for n in ("swing_angle", "swing_rate") if n in has)
    both = " and ".join(angular)
    if run.swing is not None:
        yield read_as("angle_unit", angular, f"{both} is in degrees and called rad", RAD_PER_DEGREE)
        yield read_as("angle_unit", angular, f"{both} is in rad and called degrees", 1 / RAD_PER_DEGREE)
    for said, offset in ZERO_OFFSETS.items() if run.swing == "swing_angle" else ():
        zero = f"the zero of swing_angle is off by {said}: 0 is hanging"
        yield read_as("position_offset", ("swing_angle",), zero, offset=-offset)
    if "gripper_x" in has:
        if run.swing is not None:
            said = f"{both} count the other way than gripper_x: the load is at gripper_x - l sin(angle)"
            yield replace(read_as("position_sign", angular, said, -1.0), channels=(*angular, "gripper_x"))
        for unit, factor in {**LENGTH_UNITS, "m, and called mm": 1e3}.items():
            said = f"gripper_x is in {unit}" + ("" if "called" in unit else " and called m")
            yield read_as("scale", ("gripper_x",), said, factor)
        yield from stamped(
            (n for n in has if n != "gripper_x"), SWING_CLOCK_SHIFTS, "what swings is stamped {} against gripper_x", 2.0
        )
        others = tuple(n for n in has if n != "gripper_x")
        said = "what swings is stamped {} against gripper_x"
        for pace in CLOCK_RATE_ERRORS:
            found = read_as("clock_shift", others, said.format(stamps(0.0, pace)), pace=pace, price=2.0)
            yield replace(found, clock=said)
    if "load_force" in has:
        for unit, factor in FORCE_UNITS.items():
            yield read_as("torque_unit", force, f"load_force is in {unit} and called N", factor)
        yield read_as("torque_sign", force, "load_force has the wrong sign: a string pulls", -1.0)
        if run.swing is not None:
            yield from stamped(force, SWING_CLOCK_SHIFTS, "load_force is stamped {} against the swing", 2.0)
