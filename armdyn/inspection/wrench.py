"""Check the wrench of a force/torque sensor against the arm's model: its sign, its axes, and whether it was zeroed.

With the axes corrected, a wrench is linear in the ten inertial parameters of the tool, six offsets and their drifts. A
correction is a mistake of the recording if it explains the wrench by a body that can exist, and the recording as it is
does not.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product

import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import measured_motion
from armdyn.arm.prepared import samples_inside_motion
from armdyn.arm.wrench.prediction import CutMotionSamples
from armdyn.arm.wrench.sensor import WRENCH_AXES, WrenchAxes, WrenchSensor, cut_at_sensor
from armdyn.estimation.solve import least_squares
from armdyn.inspection.check import MODEL_PLACEHOLDER, Check, Severity, rounded
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.kinematics import local_averages
from armdyn.recording.noise import ABS_NORMAL_MEDIAN_OVER_STD
from armdyn.run import Run

WRENCH_MOMENTS = 240
"""Number of moments of a recording at which a wrench is compared with the model."""
INDEPENDENT_WRENCHES = 40.0
"""Number of independent samples of the model's own error in an axis: what cables and calibrations do is as slow as the
motion."""
MODEL_ERROR_SHARE = 0.1
"""Size of the model's own error, as a share of a channel, below which two corrections explain a wrench equally well."""
CERTAIN_NATS, MAX_RESIDUAL_SHARE, MIN_GAIN = 20.0, 0.35, 2.0
"""Log odds over the recording as it is from which a correction is a mistake; largest residual after it, as a share of
what changes in the wrench; and how many times smaller than before it has to be."""
STEP_SECONDS, OUTLYING_SIZES, STEP_SIZES, STEP_AXES, LASTING_SHARE = 0.1, 5.0, 10.0, 3, 0.5
"""Time, s, between averages whose difference shows a step; size from which on the fit of the tool leaves a difference
out, and least size of a step, in the usual ones; least number of axes with a step, and least share of it that is still
there half a second later."""
ZEROED_SHARE = 0.15
"""Least reading during a step, as a share of the step, of a sensor that was zeroed."""


SIGNS: Mapping[tuple[int, int], str] = {(1, 1): "", (-1, -1): "wrench", (-1, 1): "force", (1, -1): "torque"}
"""Signs of force and torque, and what has the wrong one."""


@dataclass(frozen=True, eq=False)
class SampledWrench:
    """The whole wrench of a sensor at some moments of a recording.

    Attributes:
        model: the model of the arm.
        sensor: the sensor.
        run: the recording, without a gap.
    """

    model: ArmModel
    sensor: WrenchSensor
    run: Run

    def at(self, time: np.ndarray) -> CutMotionSamples:
        """The motion at (n,) times, with the wrench of the described bodies."""
        motion = measured_motion(self.run, self.model.arm.joints).at(time)
        return CutMotionSamples.of(
            cut_at_sensor(self.model.arm, self.sensor), MotionSamples(self.model.arm.model, motion, time)
        )

    def read(self, time: np.ndarray, near: float) -> np.ndarray:
        """(n, 6) averages of the recorded wrench around (n,) times, `near` s to either side."""
        return np.column_stack([local_averages(self.run.channels[name], time, near) for name in self.sensor.channels])

    @cached_property
    def span(self) -> tuple[float, float]:
        """First and last moment, s, at which the motion is known."""
        first = self.run.channels[self.sensor.channels[0]]
        inside = first.time[samples_inside_motion(first, measured_motion(self.run, self.model.arm.joints))]
        return float(inside[0]), float(inside[-1])


def wrench_checks(model: ArmModel, run: Run) -> Iterator[Check]:
    """Findings on the sensors of an arm whose six axes a recording contains."""
    for sensor in model.sensors.values():
        if len(sensor.recorded(run)) == len(WRENCH_AXES):
            sampled = SampledWrench(model, sensor, run)
            steps = list(_steps(sampled))
            yield from steps or _axes(sampled)


def _axes(sampled: SampledWrench) -> Iterator[Check]:
    """Finding on the axes or the sign of a wrench, if another meaning explains it much better."""
    sensor, time = sampled.sensor, np.linspace(*sampled.span, WRENCH_MOMENTS)
    if sensor.axes is WrenchAxes.BASE:
        return  # what is compared is along the sensor's axes
    stretch, y = sampled.at(time), sampled.read(time, STEP_SECONDS / 2)
    to_base = stretch.poses[:, 1:10].reshape(-1, 3, 3)  # column by column: the transpose of base to sensor
    in_base = np.hstack([np.einsum("nji,nj->ni", to_base, y[:, k : k + 3]) for k in (0, 3)])
    meanings = [(matrix, signs) for matrix in _rotations() for signs in SIGNS]
    parts = y[:, :3], y[:, 3:]
    readings = [np.hstack([s * part @ m.T for s, part in zip(signs, parts, strict=True)]) for m, signs in meanings]
    shares = _residual_shares(stretch, [*readings, in_base])
    nats = -0.5 * INDEPENDENT_WRENCHES * 3.0 * np.sum(np.log(shares + MODEL_ERROR_SHARE**2), axis=1)
    best = int(np.argmax(nats))
    gain, left = float(nats[best] - nats[0]), shares[best]
    if gain < CERTAIN_NATS or np.any(left > MAX_RESIDUAL_SHARE**2) or shares[0].sum() < MIN_GAIN**2 * left.sum():
        return
    sure = f"{rounded(gain)} nats more probable than as it is, with any tool, offsets and drifts"
    if best == len(meanings):
        yield Check(
            "wrench_frame", Severity.WRONG, sampled.run.name, sensor.channels,
            f"the wrench of {sensor.name} is along the axes of the base ({sure})",
            f'write axes = "base" below [wrench.{sensor.name}] of {MODEL_PLACEHOLDER}', evidence=gain,
        )  # fmt: skip
        return
    matrix, signs = meanings[best]
    correction = Correction(dict(_reading(sensor, matrix, signs, i) for i in range(len(WRENCH_AXES))))
    turned = not np.array_equal(matrix, np.eye(3))
    said = [f"its {SIGNS[signs]} has the wrong sign"] if SIGNS[signs] else []
    said += ["its axes are " + ", ".join(_named(matrix, axis) for axis in "xyz")] if turned else []
    remedy = f"armdyn inspect {MODEL_PLACEHOLDER} {sampled.run.source or sampled.run.name} --fix fixed"
    yield Check(
        "wrench_frame" if turned else "wrench_sign", Severity.WRONG, sampled.run.name, sensor.channels,
        f"{sensor.name}: {' and '.join(said)} ({sure})",
        f"{remedy}, or state rpy below [wrench.{sensor.name}]" if turned else remedy,
        evidence=gain, correction=correction,
    )  # fmt: skip


def _residual_shares(stretch: CutMotionSamples, readings: Sequence[np.ndarray]) -> np.ndarray:
    """(h, 2) mean squared residuals of force and torque of h readings (n, 6), as shares of what changes in them.

    A reading is explained by a tool, offsets and drifts; one that needs a tool of less than no mass by no tool at all.
    """
    cut, time = stretch.cut, stretch.motion.time
    varying = [np.mean(np.var(part, axis=0)) for y in (readings[0], readings[-1]) for part in (y[:, :3], y[:, 3:])]
    sizes = np.repeat(np.sqrt(np.max(np.reshape(varying, (2, 2)), axis=0)), 3)
    if not np.all(sizes > 0.0):
        return np.ones((len(readings), 2))
    drifting = np.kron(np.column_stack([np.ones(len(time)), time - time[0]]), np.eye(len(WRENCH_AXES)))
    by_tool = np.stack([stretch.by_inertia[axis][:, 0] for axis in cut.axes], axis=1)
    own = cut.model.inertias[cut.tool + 1].toDynamicParameters()
    beyond = stretch.described[:, list(cut.axes)] - by_tool @ own
    scale = np.tile(1.0 / sizes, len(time))[:, None]
    with_tool = np.hstack([by_tool.reshape(len(drifting), -1), drifting]) * scale
    drifting *= scale
    gaps = np.array([((y - beyond) / sizes).ravel() for y in readings]).T
    found, alone = (least_squares(columns, gaps, 1e-8) for columns in (with_tool, drifting))
    left = np.where(found[0] < 0.0, gaps - drifting @ alone, gaps - with_tool @ found)
    return np.asarray(np.mean(left.T.reshape(len(readings), -1, 2, 3) ** 2, axis=(1, 3)))


def _rotations() -> list[np.ndarray]:
    """The 24 turns of axes onto axes, the identity first."""
    found = [
        np.eye(3)[list(order)] * np.array(signs)
        for order in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    ]
    return [matrix for matrix in found if np.linalg.det(matrix) > 0.0]


def _reading(sensor: WrenchSensor, matrix: np.ndarray, signs: tuple[int, int], i: int) -> tuple[str, CorrectedReading]:
    k, row = divmod(i, 3)
    source = int(np.flatnonzero(matrix[row])[0])
    return sensor.channels[i], CorrectedReading(sensor.channels[3 * k + source], float(signs[k] * matrix[row, source]))


def _named(matrix: np.ndarray, axis: str) -> str:
    """Which axis of the frame that the model states a recorded axis is: ``x for -y``."""
    column = matrix[:, "xyz".index(axis)]
    i = int(np.flatnonzero(column)[0])
    return f"{axis} for {'-' if column[i] < 0 else ''}{'xyz'[i]}"


def _steps(sampled: SampledWrench) -> Iterator[Check]:
    """Finding on the largest step of a wrench at which the motion has none, if any."""
    begin, end = sampled.span
    time = np.arange(begin, end, STEP_SECONDS)
    if len(time) < WRENCH_MOMENTS // 4:
        return
    stretch, y = sampled.at(time), sampled.read(time, STEP_SECONDS / 2)
    tool = np.stack([stretch.by_inertia[axis][:, 0] for axis in stretch.cut.axes], axis=1)
    gap = np.diff(y - stretch.described[:, list(stretch.cut.axes)], axis=0)
    columns = np.diff(tool, axis=0).reshape(gap.size, -1)

    def left_of(kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 6) what a tool that fits the (n,) `kept` differences leaves of all, and its usual size (6,)."""
        rows = kept.repeat(len(WRENCH_AXES))
        found = least_squares(columns[rows], gap.ravel()[rows], 1e-8)
        left = gap - (columns @ found).reshape(gap.shape)
        return left, np.median(np.abs(left), axis=0) / ABS_NORMAL_MEDIAN_OVER_STD

    rough, size = left_of(np.ones(len(gap), dtype=bool))
    left, spread = left_of(np.all(np.abs(rough) < OUTLYING_SIZES * size, axis=1))
    both = left[1:] + left[:-1]  # a step between two averages, or within one
    at = int(np.argmax(np.sum(np.minimum(np.abs(both / spread), 100.0), axis=1)))
    large = np.abs(both[at]) > STEP_SIZES * spread
    around = slice(max(at - 1, 0), at + 7)
    lasts = np.abs(left[around].sum(axis=0)) > LASTING_SHARE * np.abs(both[at])
    if np.count_nonzero(large & lasts) < STEP_AXES:
        return
    moments = np.linspace(time[at], time[at + 2], 21)
    when, after = float(time[at + 1]), min(sampled.read(moments, moments[1] - moments[0]), key=np.linalg.norm)
    zeroed = bool(np.all((np.abs(after) < ZEROED_SHARE * np.abs(both[at]) + 5.0 * spread)[large]))
    name = sampled.sensor.name
    said = f"{name} was zeroed at {when:.4g} s" if zeroed else f"the wrench of {name} steps at {when:.4g} s and stays"
    yield Check(
        "wrench_zeroed", Severity.WRONG if zeroed else Severity.SUSPECT, sampled.run.name, sampled.sensor.channels,
        said if zeroed else f"{said}: a load was gripped, or something touches the tool",
        f"cut the recording at {when:.4g} s", when, float(time[-1]),
    )  # fmt: skip
