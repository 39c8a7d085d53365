"""Whatever fails in the loop: the arm is at rest, the recording can be read, and the result says why in a sentence."""

import json
import re
import resource
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from faults.faulty import AT_REST, BadForce, ClockJumps, Raises, Signals, Stalls, Through, with_force
from faults.kinds import DEAD_CELLS, INF, NAN, SENSORS
from simulated_truth import gripper_truth

import ik
import urdf
from armdyn.control.task import TaskPlanner
from armdyn.errors import InputError
from armdyn.run import read_run
from pipeline.motion import LineState, LineTrajectory
from pipeline.nodes.drive import DriveNode
from pipeline.nodes.learning import EstimatorNode, SacNode
from pipeline.nodes.measurement import MeasurementNode
from pipeline.nodes.task import SwingPlanningNode, TaskSettings
from pipeline.record import Recorder
from pipeline.trial import TrialSettings, simulate_trial
from pipeline.trial.experiment import Phase

KICK, SAC, LEARNT = 0.75, 1.2, 1.5
"""Instants [s]: in the doublet, while SAC acts, after the first estimate. The arm moves in all of them."""
USUAL = ("force-nan", "q-nan", "joints-stale", "force-raises")
"""Single bad readings that are tried by default; the others with -m slow."""
PHASES = {"kick": KICK, "sac": SAC, "rest": 0.3, "learnt": LEARNT}
"""The load cell's first sample comes at 0.02 s: at rest a fault has readings before it."""
LONGEST_STOP = 0.5
"""Time from the reason to an arm that is told to stand [s]; braking from the highest speed takes 0.3 s."""
WATCHED = 0.3  # for so long it is then watched [s]


@dataclass(frozen=True)
class Case:
    """A fault, and the words that its reason holds."""

    name: str  # for the table of tests
    says: str | None  # part of the message; None where the fault is bridged and the trial goes on
    robot: Callable[[], Through] = Through  # what stands between simulation and protocol
    patch: tuple = ()  # (class, method, time from which it does something else, what it does instead)
    # whether the robot is told to brake by itself, because the line's commands cannot be trusted
    by_itself: bool = False
    slow: bool = False  # whether it is left out by default

    @property
    def as_parameter(self):
        """For the table of tests; one instant of each fault runs by default, the others with -m slow."""
        return pytest.param(self, id=self.name, marks=[pytest.mark.slow] if self.slow else [])


def lasting(name, says, robot, by_itself=False):
    """The fault from an instant of each phase on."""
    return [
        Case(f"{name}-{phase}", says, lambda at=at: robot(at, INF), by_itself=by_itself, slow=at != SAC)
        for phase, at in PHASES.items()
    ]


def single(name, robot):
    """The fault for one reading or two, which is bridged."""
    return [
        Case(f"{name}-once-{phase}", None, lambda at=at: robot(at, at + 0.0105), slow=at != SAC or name not in USUAL)
        for phase, at in PHASES.items()
    ]


def raised(error):
    def instead(*_arguments, **_named):
        raise error

    return instead


NODES = {
    "measurement": MeasurementNode, "estimator": EstimatorNode, "sac": SacNode, "task": SwingPlanningNode,
    "drive": DriveNode,
}  # fmt: skip
CASES = [
    *(case for name, (robot, says) in {**SENSORS, **DEAD_CELLS}.items() for case in lasting(name, says, robot)),
    *(case for name, (robot, _says) in SENSORS.items() for case in single(name, robot)),
    *(
        Case(
            f"force-spike-{size:g}N-{long:g}s-{phase}", None,
            lambda size=size, long=long, at=at: BadForce(with_force(lambda f: f + size), at, at + long),
            slow=(size, long, at) not in ((5.0, 0.0105, SAC), (-3.0, 0.0305, SAC)),
        )
        for size in (2.0, 5.0, 8.0, -3.0) for long in (0.0105, 0.0305) for phase, at in PHASES.items()
    ),
    *lasting("command", "the drive node failed .* link", lambda *w: Raises("command", OSError("link"), *w), True),
    *(
        Case(f"stall-{longer:g}s-{at:g}s", "stood still", lambda longer=longer, at=at: Stalls(at, longer),
             by_itself=True, slow=(at, longer) not in ((SAC, 0.05), (SAC, 2.0)))
        for longer in (0.05, 0.2, 2.0) for at in (KICK, SAC, LEARNT)
    ),
    *(
        Case(f"clock-{by:g}s-{at:g}s", "clock jumped", lambda by=by, at=at: ClockJumps(at, by), by_itself=True,
             slow=at != SAC)
        for by in (1000.0, -1.0, -0.05, NAN) for at in (KICK, SAC, LEARNT)
    ),
    *(
        Case(f"{name}-raises-{at:g}s", f"the {name} node failed at .* FloatingPointError: odd",
             patch=(node, "step", at, raised(FloatingPointError("odd"))), by_itself=name == "drive",
             slow=at == KICK)
        for name, node in NODES.items() for at in (KICK, LEARNT)
    ),
    Case("estimator-exits", "SystemExit", patch=(EstimatorNode, "step", SAC, raised(SystemExit(0)))),
    Case("estimator-out-of-memory", "MemoryError", patch=(EstimatorNode, "step", SAC, raised(MemoryError()))),
    Case("sac-bad-input", "a sentence of ours", patch=(SacNode, "step", SAC, raised(InputError("a sentence of ours")))),
    Case("reference-nan", "NaN", patch=(DriveNode, "_next", SAC, lambda _self, _now: LineState(NAN, NAN, NAN))),
    Case("reference-jump", "does not follow", patch=(DriveNode, "_next", SAC, lambda _self, _now: LineState(0.3))),
    Case("recorder-raises", "node failed", by_itself=True,
         patch=(Recorder, "record", SAC, raised(ZeroDivisionError()))),
]  # fmt: skip


def spoil(monkeypatch, robot, owner, name, at, instead):
    """Another behaviour of a method, from a time on."""
    healthy = getattr(owner, name)

    def either(*arguments, **named):
        return (instead if robot.robot.time >= at - 1e-9 else healthy)(*arguments, **named)

    monkeypatch.setattr(owner, name, either)


def assert_at_rest_within_limits(trial, robot, by_itself=False):
    """The last command is to stop, the arm stands, and no command on the way was beyond a limit."""
    limits = trial.experiment.description.limits
    assert len(robot.told[-1]) == 1
    commands = [told for told in robot.told if len(told) == 4]
    for time, q, v, a in commands:
        assert np.all((limits.lower <= q) & (q <= limits.upper)), time
        assert np.all(np.abs(v) <= 1.001 * limits.velocity), time
        assert np.all(np.abs(a) <= 1.001 * limits.acceleration), time
    for (t0, _, v0, _), (t1, _, v1, _) in pairwise(commands):
        assert np.all(np.abs(v1 - v0) <= 1.05 * limits.acceleration * max(t1 - t0, 0.01)), t1
    if not by_itself:
        assert np.all(commands[-1][2] == 0.0)
    assert abs(gripper_truth(trial.robot).s_velocity) < AT_REST
    stop = trial.experiment.span(Phase.STOP)
    if np.isfinite(stop.end - stop.start):  # not where the clock itself fails
        assert stop.end - stop.start < LONGEST_STOP + WATCHED + 1e-6


def assert_told(trial, says, out):
    """A sentence, a result that JSON can hold, and a recording that can be read."""
    result = trial.result
    assert result.stopped
    assert re.search(says, result.message), result.message
    assert "\n" not in result.message
    json.dumps(result.as_json(), allow_nan=False)
    recording = read_run(out / "trial.mcap").channels
    assert recording["q.right_s0"].time[-1] > 0.15
    assert recording["gripper_x"].time[-1] > 0.15
    assert (out / "model.toml").exists()


LEARNING = TrialSettings(estimation_time=1.2, max_length_std_for_swing=1e-6)
"""A short trial: it learns, and then ends because it is not certain enough."""


@pytest.fixture(scope="module", autouse=True)
def loaded_once():
    """The arm and its table are the same in every trial, and are never changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(urdf, "load", cache(urdf.load))
        kept = []

        def table(robot, progress=None):
            kept[:] = kept or [default_table(robot, progress=progress)]
            return kept[0]

        default_table = ik.default_table
        patch.setattr(ik, "default_table", table)
        yield


@pytest.fixture(scope="module")
def healthy():
    return simulate_trial(LEARNING).result


@pytest.mark.parametrize("case", [case.as_parameter for case in CASES])
def test_a_fault_while_learning_ends_at_rest_with_a_reason(case, tmp_path, monkeypatch, healthy):
    robot = case.robot()
    if case.patch:
        spoil(monkeypatch, robot, *case.patch)
    trial = simulate_trial(replace(LEARNING, out=tmp_path), through=robot.around)
    assert_at_rest_within_limits(trial, robot, case.by_itself)
    assert_told(trial, case.says or "did not converge", tmp_path)
    if case.says is None:
        assert trial.result.notes
        assert trial.result.length_estimate == pytest.approx(healthy.length_estimate, abs=healthy.length_std)


@pytest.fixture(scope="module")
def planned():
    """The plan of a swing, computed once: planning takes longer than everything else."""
    kept = []
    plan = TaskPlanner.plan

    def once(*arguments):
        kept[:] = kept or [plan(*arguments)]
        return kept[0]

    return once


SWINGING = TrialSettings(length_guess=0.368, estimate=False, task=TaskSettings(duration=3.0))
"""It swings at once, from 0.5 to 3.5 s; the load would miss the box."""
SWING_CASES = [
    *(
        Case(
            f"{name}-{at:g}s", SENSORS[name][1], lambda name=name, at=at: SENSORS[name][0](at, INF),
            slow=at != 2.2 or name not in ("force-nan", "q-nan", "joints-stale", "joint-stamp-ahead"),
        )
        for name in SENSORS for at in (0.9, 2.2, 3.1)
    ),
    Case("played-nan", "NaN", patch=(LineTrajectory, "__getitem__", 2.2, lambda *_: LineState(NAN, NAN, NAN))),
    Case("played-jump", "does not follow", patch=(LineTrajectory, "__getitem__", 2.2, lambda *_: LineState(0.1))),
    Case("planner-raises", "task node failed .* LinAlgError: singular",
         patch=(TaskPlanner, "plan", 0.0, raised(np.linalg.LinAlgError("singular")))),
    *(
        case
        for at in (2.2, 0.9, 3.1)
        for case in (
            Case(f"command-raises-{at:g}s", "drive node failed",
                 lambda at=at: Raises("command", OSError("link"), at), by_itself=True, slow=at != 2.2),
            Case(f"stall-{at:g}s", "stood still", lambda at=at: Stalls(at, 0.1), by_itself=True, slow=at != 2.2),
            Case(f"clock-{at:g}s", "clock jumped", lambda at=at: ClockJumps(at, 1000.0), by_itself=True,
                 slow=at != 2.2),
        )
    ),
]  # fmt: skip
SWING_BY_DEFAULT = 3  # of the faults in a swing, each third runs by default


@pytest.mark.parametrize(
    "case",
    [replace(case, slow=case.slow or i % SWING_BY_DEFAULT > 0).as_parameter for i, case in enumerate(SWING_CASES)],
)
def test_a_fault_in_the_swing_ends_at_rest_with_a_reason(case, tmp_path, monkeypatch, planned):
    robot = case.robot()
    monkeypatch.setattr(TaskPlanner, "plan", planned)
    if case.patch:
        spoil(monkeypatch, robot, *case.patch)
    trial = simulate_trial(replace(SWINGING, out=tmp_path), through=robot.around)
    assert_at_rest_within_limits(trial, robot, case.by_itself)
    assert_told(trial, case.says, tmp_path)


def test_a_plan_that_is_not_a_number_never_moves_the_arm(tmp_path, monkeypatch, planned):
    robot = Through()

    def spoiled(*arguments):
        plan = planned(*arguments)
        return replace(plan, x=np.where(plan.time > 1.0, NAN, plan.x))

    monkeypatch.setattr(TaskPlanner, "plan", spoiled)
    trial = simulate_trial(replace(SWINGING, out=tmp_path), through=robot.around)
    assert all(np.all(told[2] == 0.0) for told in robot.told if len(told) == 4)
    assert_told(trial, "plan holds a NaN", tmp_path)


def test_a_full_disk_costs_the_recording_and_not_the_swing(tmp_path):
    robot = Through()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        trial = simulate_trial(replace(LEARNING, out=tmp_path), through=robot.around)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert_at_rest_within_limits(trial, robot)
    assert trial.experiment.estimator.history  # long after the disk was full
    assert "could not be written any further" in trial.result.message
    assert len(trial.experiment.channel("gripper_x")) > 50  # in memory nothing is lost
    assert read_run(tmp_path / "trial.mcap", recover=True).channels["gripper_x"].time[-1] > 0.1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("at", [0.2, SAC, *(pytest.param(at, marks=pytest.mark.slow) for at in (KICK, LEARNT))])
def test_a_signal_ends_at_rest(number, at, tmp_path, request):
    robot = Signals(number, at)
    # Started by nohup, as a long test run may be, the trial rightly ignores SIGHUP: here it must not.
    before = signal.signal(number, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(number, before))
    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    trial = simulate_trial(replace(LEARNING, out=tmp_path), through=robot.around)
    assert_at_rest_within_limits(trial, robot)
    assert_told(trial, f"(interrupted|ended) .* at {at:.2f}"[:-1], tmp_path)
    assert trial.robot.time < at + 0.5 + 0.3  # then it is watched for 0.3 s
    assert handlers == [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]


def test_a_second_ctrl_c_stops_the_arm_at_once(tmp_path):
    robot = Signals(signal.SIGINT, SAC, times=2)
    with pytest.raises(KeyboardInterrupt):
        simulate_trial(replace(LEARNING, out=tmp_path), through=robot.around)
    assert len(robot.told[-1]) == 1
    robot.robot.advance(0.5)
    assert abs(gripper_truth(robot.robot).s_velocity) < 0.02
    assert read_run(tmp_path / "trial.mcap").channels["gripper_x"].time[-1] > 1.0
