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
import pinocchio as pin

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
TURNING_ROUNDS = 3
"""Rounds in which the turn of a sensor is linearised; three are exact to 1 % of what 0.3 rad leave."""

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
    best = int(np.argmax(_nats(shares)))
    if not _is_certain(shares[0], shares[best]):
        # A turned sensor or a pull leaves more than the wrong sign of a torque: with both as unknowns, that is seen.
        best = next(k for k, (matrix, signs) in enumerate(meanings) if signs == (1, -1) and np.trace(matrix) == 3.0)
        shares[[0, best]] = [_share_beside_faults(stretch, readings[k]) for k in (0, best)]
        if not _is_certain(shares[0], shares[best]):
            return
    gain = float(_nats(shares[best]) - _nats(shares[0]))
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


def _nats(shares: np.ndarray) -> np.ndarray:
    """(...) log probability of readings, nats, from (..., 2) residuals as shares of what changes in them."""
    return np.asarray(-0.5 * INDEPENDENT_WRENCHES * 3.0 * np.sum(np.log(shares + MODEL_ERROR_SHARE**2), axis=-1))


def _is_certain(given: np.ndarray, left: np.ndarray) -> bool:
    """Whether a correction explains a wrench, and the recording as it is does not, by their (2,) residual shares."""
    gain = float(_nats(left) - _nats(given))
    return gain >= CERTAIN_NATS and bool(
        np.all(left <= MAX_RESIDUAL_SHARE**2) and given.sum() >= MIN_GAIN**2 * left.sum()
    )


def _share_beside_faults(stretch: CutMotionSamples, y: np.ndarray) -> np.ndarray:
    """(2,) shares of `_residual_shares` for one reading (n, 6), where the sensor may be turned and a cable may pull."""
    pulls = np.zeros((len(y), len(WRENCH_AXES), 12))
    pulls[:, :3, :3] = stretch.poses[:, 1:10].reshape(-1, 3, 3).transpose(0, 2, 1)  # along the base's axes
    for at, force in product(range(3), range(3)):  # torque p x F, linear in the products of their components
        pulls[:, 3:, 3 + 3 * at + force] = np.cross(np.eye(3)[at], pulls[:, :3, force])
    shares = np.ones(2)
    for _ in range(TURNING_ROUNDS):  # y + s x y is a wrench, for a small turn s
        across = np.hstack([np.cross(y[:, None, k : k + 3], np.eye(3)).transpose(0, 2, 1) for k in (0, 3)])
        (shares,), values = _fitted(stretch, [y], np.concatenate([pulls, across], axis=2))
        R = pin.exp3(values[-3:, 0])
        y = np.hstack([y[:, k : k + 3] @ R.T for k in (0, 3)])
    return np.asarray(shares)


def _residual_shares(stretch: CutMotionSamples, readings: Sequence[np.ndarray]) -> np.ndarray:
    """(h, 2) mean squared residuals of force and torque of h readings (n, 6), as shares of what changes in them."""
    return _fitted(stretch, readings, np.zeros((len(stretch.motion.time), len(WRENCH_AXES), 0)))[0]


def _fitted(
    stretch: CutMotionSamples, readings: Sequence[np.ndarray], beside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(h, 2) shares of `_residual_shares`, and the values of the fit, (10 + 12 + k, h).

    A reading is explained by a tool, offsets, drifts and further (n, 6, k) columns; one that needs a tool of less than
    no mass by no tool at all.
    """
    cut, time = stretch.cut, stretch.motion.time
    varying = [np.mean(np.var(part, axis=0)) for y in (readings[0], readings[-1]) for part in (y[:, :3], y[:, 3:])]
    sizes = np.repeat(np.sqrt(np.max(np.reshape(varying, (2, 2)), axis=0)), 3)
    if not np.all(sizes > 0.0):
        return np.ones((len(readings), 2)), np.zeros((22 + beside.shape[2], len(readings)))
    drifting = np.kron(np.column_stack([np.ones(len(time)), time - time[0]]), np.eye(len(WRENCH_AXES)))
    drifting = np.hstack([drifting, beside.reshape(len(drifting), -1)])
    by_tool = np.stack([stretch.by_inertia[axis][:, 0] for axis in cut.axes], axis=1)
    own = cut.model.inertias[cut.tool + 1].toDynamicParameters()
    beyond = stretch.described[:, list(cut.axes)] - by_tool @ own
    scale = np.tile(1.0 / sizes, len(time))[:, None]
    with_tool = np.hstack([by_tool.reshape(len(drifting), -1), drifting]) * scale
    drifting *= scale
    gaps = np.array([((y - beyond) / sizes).ravel() for y in readings]).T
    found, alone = (least_squares(columns, gaps, 1e-8) for columns in (with_tool, drifting))
    left = np.where(found[0] < 0.0, gaps - drifting @ alone, gaps - with_tool @ found)
    return np.mean(left.T.reshape(len(readings), -1, 2, 3) ** 2, axis=(1, 3)), found


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
