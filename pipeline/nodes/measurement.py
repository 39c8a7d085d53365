"""The measurement node: it reads and records joints and load cell, and detects faults of the load cell."""

from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf, isfinite

import numpy as np

import urdf
from armdyn.errors import InputError
from armdyn.pendulum.path import GripperPath, OnlinePathSmoother, RunInProgress
from armdyn.pendulum.physics import STANDARD_GRAVITY
from armdyn.run import Channel
from pipeline.loadcell.faults import LoadCellFaultDetector
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.nodes.reading_checks import ForceReadingCheck, JointReadingCheck, ReadingRefusal
from pipeline.record import Recorder
from pipeline.robot.protocol import ForceSample, JointState, RobotInterface, Vector

MAX_SLACK_STRING_FORCE = 0.02
"""Force below which the string counts as slack if it lasts for `MIN_SLACK_STRING_SECONDS` [N]; 80 g pull 0.78 N."""
MIN_SLACK_STRING_SECONDS = 0.05
"""Duration of a force below `MAX_SLACK_STRING_FORCE` after which the string counts as slack [s]."""
RECORDING_DELAY_SECONDS = 2 * MIN_SLACK_STRING_SECONDS
"""Time for which samples wait before they are recorded [s]."""
MAX_FORCE_JUMP_SHARE_OF_WEIGHT = 0.25
"""Largest change of the measured force between two samples while the string is taut, as a share of the load's weight.
Trials without faults show 0.10."""
EXTRA_JUMP_SHARE_PER_WAITING_SAMPLE = 0.05
"""Further change of the force per sample that waits after a jump, as a share of the load's weight."""
JUMP_MARGIN_STANDARD_DEVIATIONS = 10.0
"""Standard deviations of one force sample that are added to the largest allowed change between two samples."""
LINE_CHANNEL_UNITS = {"gripper_x": "m", "gripper_z": "m", "load_force": "N"}
"""Unit of each channel that describes gripper and load."""


def channel_units(joint_names: tuple[str, ...]) -> dict[str, str]:
    """Unit of each channel that the measurement node records, for an arm with these joints."""
    units = {f"{place}{name}": unit for place in ("", "landing.") for name, unit in LINE_CHANNEL_UNITS.items()}
    for prefix, unit in (("q", "rad"), ("v", "rad/s"), ("tau", "N m")):
        units |= {f"{prefix}.{name}": unit for name in joint_names}
    return units


@dataclass
class _Series:
    """A growing time series."""

    time: np.ndarray = field(default_factory=lambda: np.empty(4096))
    value: np.ndarray = field(default_factory=lambda: np.empty(4096))
    count: int = 0

    def append(self, time: float, value: float) -> None:
        if self.count == len(self.time):
            self.time = np.concatenate([self.time, np.empty_like(self.time)])
            self.value = np.concatenate([self.value, np.empty_like(self.value)])
        self.time[self.count], self.value[self.count] = time, value
        self.count += 1

    def first(self, start: float) -> int:
        """Index of the first sample at `start` [s] or later."""
        return int(np.searchsorted(self.time[: self.count], start - 1e-9))

    def since(self, start: float, unit: str, end: int | None = None) -> Channel:
        """The samples from the time `start` [s] to the index `end`, with times that count from `start`."""
        part = slice(self.first(start), self.count if end is None else end)
        return Channel(self.time[part] - start, self.value[part], unit)


class _SmoothedPath:
    """The smoothed path of the gripper since a start time [s].

    Attributes:
        count: number of samples.
        along: position, velocity and acceleration along the line, (3, count).
        height: height above the line and its derivatives, (3, count).
    """

    def __init__(self, along: _Series, height: _Series, start: float, period: float) -> None:
        self.start, self._first, self.count = start, along.first(start), 0
        self._series = along, height
        self._growing = OnlinePathSmoother(period), OnlinePathSmoother(period)
        self.along = self.height = np.empty((3, 0))

    @property
    def raw(self) -> Channel:
        """Measured position along the line, not smoothed."""
        return self._series[0].since(self.start, "m", self._first + self.count)

    def update(self, end: int) -> None:
        """Add the samples since the last update, up to the index `end`."""
        if not self.count:  # samples from before the start may arrive after it
            self._first = self._series[0].first(self.start)
        begin = self._first + self.count
        new = slice(begin, max(end, begin))
        if new.stop == self._first:
            return  # no samples yet
        pairs = zip(self._growing, self._series, strict=True)
        self.along, self.height = (growing.extend(series.value[new]) for growing, series in pairs)
        self.count = new.stop - self._first


class MeasurementNode:
    """Reads joints and load cell of the robot at 100 Hz, checks every reading, and records the good ones.

    Samples are recorded as those of a pendulum only while the load hangs freely. After the load was let down, or after
    it may have touched the box (`hangs_until`), they are recorded in channels named ``landing.*``. Samples wait for
    `RECORDING_DELAY_SECONDS`, because a slack string is noticed only later.

    Args:
        robot: the robot.
        description: the arm.
        recorder: recorder of the samples.
        detector: detector of the load cell's faults.
        noise: standard deviation of the noise by channel.
        mass: mass of the load [kg].
        clock: time of the robot at which the model's own time is 0 [s]; None for the time of `begin`.

    Attributes:
        hangs_until: time from which the load may touch the box [s].
        load_hangs: whether the load hangs on the string; False after it was let down.
        fault: why load cell, joints or string have failed; None before.
        state: latest good reading of the joints.
        gripper: latest position of the gripper along the line [m].
        joint_check: check of the joints' readings, which counts refused ones.
        force_check: check of the load cell's readings, which counts refused ones.
    """

    name = "measurement"
    period = CONTROL_PERIOD_SECONDS

    def __init__(
        self,
        robot: RobotInterface,
        description: urdf.Robot,
        recorder: Recorder,
        detector: LoadCellFaultDetector,
        noise: dict[str, float],
        mass: float,
        clock: float | None = None,
    ) -> None:
        self._robot, self._recorder, self._detector, self._noise = robot, recorder, detector, noise
        self._clock = clock
        self._arm, self._data = description, description.model.createData()
        self._gripper, self._height, self._force = _Series(), _Series(), _Series()
        self._pulled_at: float | None = None
        self._waiting: deque[tuple[str, float, float]] = deque()
        self._path: _SmoothedPath | None = None
        self._guessed = 0  # number of extrapolated samples at the end of the gripper's path
        self.load_hangs, self.hangs_until = True, inf
        self.fault: str | None = None
        weight = STANDARD_GRAVITY * mass
        jump = MAX_FORCE_JUMP_SHARE_OF_WEIGHT * weight + JUMP_MARGIN_STANDARD_DEVIATIONS * noise["load_force"]
        self.joint_check = JointReadingCheck(description.limits)
        self.force_check = ForceReadingCheck(jump, EXTRA_JUMP_SHARE_PER_WAITING_SAMPLE * weight, MAX_SLACK_STRING_FORCE)
        self.state: JointState = robot.joint_state()
        self.gripper_position = self._locate(self.state.q)[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence per device and reason for which readings were refused."""
        return self.joint_check.notes + self.force_check.notes

    def step(self, now: float) -> None:
        """Read joints and load cell, record the good readings, and detect faults."""
        self._take_joints()
        wait = self._waiting.append
        samples = self._force_samples()
        for sample in samples:
            self._force.append(sample.time, sample.force)
            wait(("load_force", sample.time, sample.force))
            if sample.force > MAX_SLACK_STRING_FORCE or self._pulled_at is None or not self.load_hangs:
                self._pulled_at = sample.time
            elif sample.time - self._pulled_at > MIN_SLACK_STRING_SECONDS and self.fault is None:
                self.fault = (
                    f"the string has been slack since {self._pulled_at:.2f} s: move less, or hang a heavier load"
                )
                self.let_down(self._pulled_at)
        self._record_until(now - RECORDING_DELAY_SECONDS)
        found = self._detector.update(now, [*samples, *self.force_check.failed])
        if found is not None and self.load_hangs and self.fault is None:
            self.fault = f"load cell at {now:.2f} s: {found.value}"
        # The load cell is not needed once the load is let down; the joints are needed as long as the arm moves.
        bad_force = self.force_check.fault if self.load_hangs else None
        self.fault = self.fault or self.joint_check.fault or bad_force

    def _take_joints(self) -> None:
        """Read and record the joints once; a bad reading is replaced by extrapolation in the gripper's path."""
        now = self._robot.time
        try:
            state = self._robot.joint_state()
        except Exception:  # a driver may raise any error: this reading is missing
            self.joint_check.refuse(ReadingRefusal.UNREADABLE, now)
            self._bridge()
            return
        if self.joint_check.check(state, now) is not None:
            self._bridge()
            return
        self.state = state
        along, height = self._locate(state.q)
        if self._gripper.count and state.time <= self._gripper.time[self._gripper.count - 1]:
            return  # an extrapolated sample is there already
        self._append(state.time, along, height)
        self._guessed = 0
        self._waiting.append(("gripper_x", state.time, along))
        self._waiting.append(("gripper_z", state.time, height))
        for prefix, values in (("q", state.q), ("v", state.v), ("tau", state.tau)):
            for name, value in zip(self._arm.joint_names, values, strict=True):
                if isfinite(value):  # quantities that the robot does not report are missing
                    self._recorder.record(f"{prefix}.{name}", state.time, float(value))

    def _locate(self, q: Vector) -> tuple[float, float]:
        """Position of the gripper along the line, and height above it [m], at joint positions q (n,)."""
        return self._arm.line.coordinates(self._arm.tool_pose(q, self._data).translation)

    def _bridge(self) -> None:
        """Extrapolate the gripper's path over a missing reading, since the path needs a value in every period."""
        if self._gripper.count and self.joint_check.fault is None:
            time = float(self._gripper.time[self._gripper.count - 1]) + self.period
            self._append(time, *self._locate(self.joint_check.extrapolated(time - self.state.time)))
            self._guessed += 1

    def _append(self, time: float, along: float, height: float) -> None:
        """Append a sample to the gripper's path; missed cycles are interpolated linearly."""
        self.gripper_position = along
        last = self._gripper.count - 1
        if last >= 0:
            before = float(self._gripper.time[last]), float(self._gripper.value[last]), float(self._height.value[last])
            missed = round((time - before[0]) / self.period) - 1
            for k in range(1, missed + 1):
                share = k / (missed + 1)
                stamp, x, z = (a + share * (b - a) for a, b in zip(before, (time, along, height), strict=True))
                self._gripper.append(stamp, x)
                self._height.append(stamp, z)
        self._gripper.append(time, along)
        self._height.append(time, height)

    def _force_samples(self) -> list[ForceSample]:
        """The good samples of the load cell since the last step."""
        now = self._robot.time
        try:
            samples = self._robot.load_cell()
        except Exception:  # a driver may raise any error: these samples are missing
            self.force_check.refuse(ReadingRefusal.UNREADABLE, now)
            return []
        return self.force_check.check(samples, now, self.hangs_until)

    def discard_stale_samples(self) -> None:
        """Drop the samples that wait in the load cell, because they are too old."""
        with suppress(Exception):  # a cell that cannot be read is treated in the next step
            self._robot.load_cell()

    def mark_possible_touch_from(self, time: float) -> None:
        """Record later samples in channels ``landing.*``, because the load may touch the box from `time` [s] on."""
        self.hangs_until = time

    def let_down(self, time: float) -> None:
        """Record later samples in channels ``landing.*``, because the load was let down at `time` [s]."""
        self._record_until(time)
        self.load_hangs, self.hangs_until = False, min(time, self.hangs_until)

    def finish(self) -> None:
        """Record the samples that wait, and complete the run."""
        self._record_until(inf)
        self.append_to_smoothed_path()

    def _record_until(self, time: float) -> None:
        while self._waiting and self._waiting[0][1] <= time:
            name, stamp, value = self._waiting.popleft()
            place = "" if stamp <= self.hangs_until else "landing."
            self._recorder.record(f"{place}{name}", stamp, value)

    def begin(self) -> None:
        """Begin the run for the estimator at the present time, while the load hangs at rest."""
        self._path = _SmoothedPath(self._gripper, self._height, self._robot.time, self.period)

    def append_to_smoothed_path(self) -> None:
        """Add the samples since the last call to the smoothed path of the run."""
        if self._path is not None:
            # The end of a path affects its accelerations most: no extrapolated sample may be there.
            self._path.update(self._gripper.count - self._guessed)

    def run(self) -> RunInProgress:
        """The run that was measured from `begin` to the last `append_to_smoothed_path`; its time starts at 0.

        Raises:
            InputError: there are no samples, because `begin` or `append_to_smoothed_path` was not called.
        """
        if self._path is None or not self._path.count:
            raise InputError("there is no run yet: begin it, let the measurement node make a step, and update its path")
        start, raw = self._path.start, self._path.raw
        x, v, a = self._path.along
        elapsed = self.model_time(start)
        path = GripperPath(float(raw.time[0]), self.period, x, v, a, self._path.height, elapsed)
        end = self._force.first(start + float(raw.time[-1]) + self.period / 2) if self._guessed else None
        channels = {"gripper_x": raw, "load_force": self._force.since(start, "N", end)}
        return RunInProgress(
            "trial",
            channels,
            noise=self._noise,
            path=path,
            began=None if self._clock is None else float(raw.time[0]) - elapsed,
        )

    def model_time(self, now: float) -> float:
        """The model's own time at the time `now` of the robot [s], for effects that change with time."""
        start = self._path.start if self._path is not None else now
        return now - (start if self._clock is None else self._clock)
