r"""Recordings of a pendulum against its equations, at a few moments, under every way in which they may be meant.

    phi'' = (u cos phi - g sin phi)/l - friction,      T = m (g cos phi + l phi'^2 + u sin phi)

with phi, phi' and phi'' from the smoothed angle, or rate, and u from the smoothed pivot. Both are linear in 1/l, m, m l
and the sizes of effects, so that one evidence serves pendulums and arms.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from armdyn.inspection.correction import Correction
from armdyn.inspection.evidence import Channels, Evidence, evidence, independent
from armdyn.inspection.hypotheses import DEGREE, LENGTH_UNITS, QUARTERS, Hypothesis, read_as, stamped
from armdyn.inspection.kinematics import averages
from armdyn.model import Model
from armdyn.run import Run
from armdyn.smoothing import ORDERS, Curve, best_smoothing, smoothed

MOMENTS = 240
"""At which a recording is looked at."""
GUESSED = {"length": 3.0, "mass": 30.0}
"""Relative width of what is a guess: few pendulums are longer than a metre, and loads are of any size."""
MEASURED = 0.1
"""Relative width of what was measured by hand, other effects being there."""
THINNED = 3000
"""Samples of a channel from which a motion is smoothed."""
BEYOND, LIGHT = 30.0, 0.3
"""Nats, and share of the load's weight from which a load cell may be wrong, or another load hang there."""
FORCE_UNITS = {"mN": 1e-3, "gram-force": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216}
"""N."""
LATE = (-0.5, -0.4, -0.3, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""s; what is late by less is a delay of a sensor, an effect."""
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class SwingRun:
    """One recording of a pendulum at a few moments.

    Args:
        model: of the load.
        run: as recorded, without a gap.
    """

    model: Model
    run: Run

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """What is compared: the angle (or else the rate), and the force."""
        swing = next((n for n in ("swing_angle", "swing_rate") if n in self.run.channels), None)
        return (*((swing,) if swing else ()), *(("load_force",) if "load_force" in self.run.channels else ()))

    @property
    def swing(self) -> str | None:
        """The channel that shows the motion."""
        return self.channels[0] if self.channels and self.channels[0] != "load_force" else None

    @cached_property
    def moments(self) -> np.ndarray:
        """(n,) s."""
        used = [self.run.channels[n] for n in (*self.channels, "gripper_x") if n in self.run.channels]
        begin, end = max(c.time[0] for c in used), min(c.time[-1] for c in used)
        edge = 0.03 * (end - begin)
        return np.linspace(begin + edge, end - edge, MOMENTS)

    @cached_property
    def _curves(self) -> dict[str, Curve]:
        found: dict[str, Curve] = {}
        for name in ("swing_angle", "swing_rate", "gripper_x"):
            if name in self.run.channels and name in (self.swing, "gripper_x"):
                whole = self.run.channels[name]
                c = whole.averaged(-(-len(whole) // THINNED))
                found[name] = smoothed(c.time, c.value, best_smoothing(c.time, c.value, ORDERS[:2]))
        return found

    @cached_property
    def motion(self) -> Callable[[float], Motion]:
        """(n,) angle, rate and acceleration of the angle as recorded, whose stamps are so much too large; kept."""
        return cache(self._motion)

    def _motion(self, late: float) -> Motion:
        time = self.moments + late
        curve = self._curves[self.swing or ""]
        if self.swing == "swing_angle":
            angle, rate, bend = (curve(time, k)[:, 0] for k in range(3))
            return angle, rate, bend
        rate, bend = (curve(time, k)[:, 0] for k in range(2))
        fine = np.linspace(time[0], time[-1], 8 * MOMENTS)
        values = curve(fine, 0)[:, 0]
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(fine))])
        angle -= np.polyval(np.polyfit(fine, angle, 1), fine)
        return np.interp(time, fine, angle), rate, bend

    def pull(self, late: float) -> np.ndarray:
        """(n,) acceleration of the pivot as recorded, m/s^2."""
        if "gripper_x" not in self._curves:
            return np.zeros(MOMENTS)
        return np.asarray(self._curves["gripper_x"](self.moments + late, 2)[:, 0])

    def force(self, late: float) -> np.ndarray:
        """(n,) of the load cell as recorded, averaged around the moments."""
        return averages(self.run.channels["load_force"], self.moments + late)

    @cached_property
    def weights(self) -> np.ndarray:
        """(J,) independent samples per sample."""
        given = self._given(Correction(), np.full(len(self.channels), 0.3))
        return independent(given.measured, evidence(given).left, given.least)

    def rough(self, meanings: Sequence[tuple[Correction, object]]) -> np.ndarray:
        """(h,) as `sure`: a pendulum has few effects."""
        return np.array([self.sure(*meaning).value for meaning in meanings])

    def sure(self, correction: Correction, description: object = None) -> Evidence:
        """Evidence with every effect that there may be."""
        del description
        given = self._given(correction, self.weights)
        found = evidence(given)
        return replace(found, value=found.value - self._outside(given))

    def _outside(self, given: Channels) -> float:
        """Nats that a force costs with which no string holds this load."""
        if "load_force" not in self.channels:
            return 0.0
        mass, weighed = self._known("mass")
        share = float(np.mean(given.measured[-1])) / (mass * self._known("gravity")[0])
        return BEYOND * (float(share < 0.0) + float(weighed and not LIGHT < abs(share) < 1.0 / LIGHT))

    def nothing(self) -> float:
        """Evidence of equations that say nothing: none, as a pendulum's are known."""
        return -np.inf

    def with_run(self, run: Run) -> "SwingRun":
        """The same of another recording."""
        return replace(self, run=run)

    def _known(self, name: str) -> tuple[float, bool]:
        """SI value of length, mass or gravity, and whether somebody measured it."""
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
            u = r.factor * self.pull(r.late)
        if self.swing is not None:
            r = correction.reading(self.swing)
            angle, rate, bend = (r.factor * x for x in self.motion(r.late))
            angle = angle + r.offset
            drive, weightless = u * np.cos(angle) / length, -gravity * np.sin(angle) / length
            width = MEASURED if measured else GUESSED["length"]
            pace = gravity / length
            rows.append(bend)
            described.append((drive + weightless) if measured else np.zeros(n))
            X = [
                width * (drive + weightless), 0.15 * drive, -0.5 * rate, -np.tanh(20.0 * rate),
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
            width = MEASURED if weighed else GUESSED["mass"]
            static = gravity * np.cos(angle) + u * np.sin(angle)
            rows.append(r.factor * self.force(r.late))
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
            np.array(rows), np.array(described), whole, np.concatenate(signs), weight, np.array(volume), np.array(least)
        )


def mistakes(run: SwingRun) -> Iterator[Hypothesis]:
    """What people do to recordings of pendulums by mistake."""
    has, force = run.run.channels, ("load_force",)
    angular = tuple(n for n in ("swing_angle", "swing_rate") if n in has)
    both = " and ".join(angular)
    if run.swing is not None:
        yield read_as("angle_unit", angular, f"{both} is in degrees and called rad", DEGREE)
        yield read_as("angle_unit", angular, f"{both} is in rad and called degrees", 1 / DEGREE)
    for said, offset in QUARTERS.items() if run.swing == "swing_angle" else ():
        zero = f"the zero of swing_angle is off by {said}: 0 is hanging"
        yield read_as("position_offset", ("swing_angle",), zero, offset=-offset)
    if "gripper_x" in has and run.swing is not None:
        said = f"{both} count the other way than gripper_x: the load is at gripper_x - l sin(angle)"
        yield replace(read_as("position_sign", angular, said, -1.0), channels=(*angular, "gripper_x"))
        for unit, factor in {**LENGTH_UNITS, "m, and called mm": 1e3}.items():
            said = f"gripper_x is in {unit}" + ("" if "called" in unit else " and called m")
            yield read_as("scale", ("gripper_x",), said, factor)
        yield from stamped(
            (n for n in has if n != "gripper_x"), LATE, "what swings is stamped {} against gripper_x", 2.0
        )
    if "load_force" in has:
        for unit, factor in FORCE_UNITS.items():
            yield read_as("torque_unit", force, f"load_force is in {unit} and called N", factor)
        yield read_as("torque_sign", force, "load_force has the wrong sign: a string pulls", -1.0)
        if run.swing is not None:
            yield from stamped(force, LATE, "load_force is stamped {} against the swing", 2.0)
