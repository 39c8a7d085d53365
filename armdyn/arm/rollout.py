"""How far the motion of a model is from the robot's: an arm simulated by what its drives were told, or gave.

Where every joint has a command the loop is closed, and whole recordings are simulated from their first state; a
measured torque alone pulls nothing back, so that windows are begun anew at the measured motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pinocchio as pin

from armdyn.arm.drives import TOLD, Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import measured_motion
from armdyn.arm.readings import mean_held, mean_told
from armdyn.arm.simulator import Drives, simulate
from armdyn.kept import cached_with_first_argument
from armdyn.run import Run

STEP, COARSE_STEP = 0.001, 0.004
"""Longest step of the simulation, s, and of one that only leads near an optimum. In arms that stick and slide the error
of the first is below an encoder's noise; that of the second is up to ten times larger, and bends frictions."""
STIFF = 0.5
"""Of the time sqrt(I/k) in which a servo pulls back what it moves, that a step lasts at most."""
WINDOWS = (0.5, 5.0)
"""s, of what cannot be simulated as a whole."""
ROUNDING = 1e-6
"""rad or m; what is less is no encoder's step: it is how a recording was written down."""
LOST = 2.0 * np.pi
"""rad or m: a simulated joint that is farther from where it was has left the motion, and how far says nothing."""
LATE, TOLD_LATE = "torque_delay.time", "command_delay.time"
"""Parameters by which a measured torque is read late, and a command acts late."""


@dataclass(frozen=True)
class RollOut:
    """The error of one joint's simulated position in one run; see the contract's `rollout`.

    Attributes:
        run: its name.
        role: ``"training"``, ``"held_out"`` or ``"exam"``.
        kind: ``"closed_loop"``, or ``"window_0.5"`` and ``"window_5"``.
        joint: which.
        unit: rad or m.
        rms: root of the mean square; None where the simulated joint left the motion by more than `LOST`.
        mae: mean absolute error, likewise.
        position_is_command: rms and mean absolute error of a joint that is always where it was told to be; None where
            it was told no position.
        resolution: step of the encoder, 0 where none shows.
        time: (n,) s of the recorded positions, increasing.
        measured: (n,) recorded positions.
        simulated: (n,) simulated ones.
        told: (n,) positions that it was told; None where it was told none.
    """

    run: str
    role: str
    kind: str
    joint: str
    unit: str
    rms: float | None
    mae: float | None
    position_is_command: tuple[float, float] | None
    resolution: float
    time: np.ndarray = field(repr=False, compare=False)
    measured: np.ndarray = field(repr=False, compare=False)
    simulated: np.ndarray = field(repr=False, compare=False)
    told: np.ndarray | None = field(repr=False, compare=False)


def closed(model: ArmModel, run: Run) -> bool:
    """Whether every joint of the arm was told its position."""
    servos = [model.servo(joint) for joint in model.arm.joints]
    return all(
        servo is not None and servo.law == "position" and f"q_cmd.{joint}" in run.channels
        for servo, joint in zip(servos, model.arm.joints, strict=True)
    )


def can_roll_out(model: ArmModel, run: Run) -> bool:
    """Whether the recording says what drove every joint, and the model has nothing that depends on what was before."""
    for joint in model.arm.joints:
        servo = model.servo(joint)
        told = servo is not None and servo.gain is not None and f"{TOLD[servo.law]}.{joint}" in run.channels
        if not told and f"tau.{joint}" not in run.channels:
            return False
    return not model.arm.carried and not model.remembers


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a recording that is simulated from its first state.

    Attributes:
        run: the recording.
        begin: s.
        end: s.
        start: (nj,) positions and velocities.
        time: (n,) s of the recorded positions.
        q: (n, nj) recorded positions.
    """

    run: Run
    begin: float
    end: float
    start: tuple[np.ndarray, np.ndarray]
    time: np.ndarray
    q: np.ndarray


@cached_with_first_argument
def windows(run: Run, joints: tuple[str, ...], length: float) -> tuple[Window, ...]:
    """Stretches of `length` s of a recording, infinite for the whole, at the stamps of its first joint."""
    motion = measured_motion(run, joints)
    first = run.channels[f"q.{joints[0]}"].time
    time = first[(first >= motion.start) & (first <= motion.end)]
    recorded = np.column_stack(
        [np.interp(time, run.channels[f"q.{j}"].time, run.channels[f"q.{j}"].value) for j in joints]
    )
    lasts = float(time[-1] - time[0])
    count = 1 if lasts <= length else int(lasts / length)
    edges = time[0] + np.arange(count + 1) * min(length, lasts)
    found = []
    for begin, end in pairwise(edges):
        inside = (time >= begin - 1e-9) & (time <= end + 1e-9)
        at = motion.at(np.array([begin]))
        found.append(Window(run, float(begin), float(end), (at.q[0], at.v[0]), time[inside], recorded[inside]))
    return tuple(found)


def rolled(
    model: ArmModel,
    theta: np.ndarray,
    window: Window,
    servos: Sequence[Servo | None] | None = None,
    longest: float = STEP,
) -> np.ndarray:
    """(n, nj) simulated positions at the stamps of a window.

    Args:
        model: the arm.
        theta: (p,) its parameters.
        window: what is simulated.
        servos: by joint, in place of those of the model.
        longest: longest step of the simulation, s.
    """
    own = [model.servo(joint) for joint in model.arm.joints] if servos is None else list(servos)
    step = min(longest, _stiff_step(model, theta, own))
    count = max(1, int(np.ceil((window.end - window.begin) / step - 1e-9)))
    edges = window.begin + step * np.arange(count + 1)
    q, _ = simulate(model, theta, window.start, _drives(model, theta, window.run, own, edges), step)
    return np.column_stack([np.interp(window.time, edges, q[:, j]) for j in range(q.shape[1])])


def _stiff_step(model: ArmModel, theta: np.ndarray, servos: Sequence[Servo | None]) -> float:
    """Longest step, s, in which no servo pulls back what it moves; infinite without a position servo."""
    rigid, lasts = model.rigid_at(theta), np.inf
    mass = np.diag(pin.crba(rigid, rigid.createData(), pin.neutral(rigid)))
    for inertia, servo in zip(mass.tolist(), servos, strict=True):
        if servo is not None and servo.gain is not None and servo.law == "position":
            lasts = min(lasts, STIFF * float(np.sqrt(inertia / servo.gain.value)))
    return lasts


def _drives(model: ArmModel, theta: np.ndarray, run: Run, servos: Sequence[Servo | None], edges: np.ndarray) -> Drives:
    n, m = len(edges) - 1, len(servos)
    given, q_cmd, v_cmd, on, voltage = (np.zeros((n, m)) for _ in range(5))
    limit, gain, damping = np.full((n, m), np.inf), np.zeros(m), np.zeros(m)
    middle = (edges[1:] + edges[:-1]) / 2
    for j, (joint, servo) in enumerate(zip(model.arm.joints, servos, strict=True)):
        late, told_late = (
            float(theta[model.names.index(name)]) if (name := f"{of}[{joint}]") in model.parameters else 0.0
            for of in (LATE, TOLD_LATE)
        )
        channels = run.channels
        if servo is None or servo.gain is None or f"{TOLD[servo.law]}.{joint}" not in channels:
            on[:, j] = 1.0
            given[:, j] = np.interp(middle + late, channels[f"tau.{joint}"].time, channels[f"tau.{joint}"].value)
            continue
        share, scale = servo.gate(run, joint, middle)
        told = edges - (servo.delay or 0.0) - told_late
        voltage[:, j] = servo.over_reference(run, joint, middle)
        if servo.law in ("torque", "current"):
            value = scale * servo.gain.value * mean_told(run, joint, servo, told)
            given[:, j], on[:, j] = share * np.clip(value, -servo.largest, servo.largest), share
            continue
        on[:, j], limit[:, j] = share * scale, servo.largest / scale
        if servo.law == "position":
            q_cmd[:, j] = mean_told(run, joint, servo, told)
            gain[j], damping[j] = servo.gain.value, servo.damping
        else:
            damping[j] = servo.gain.value
        if f"v_cmd.{joint}" in channels:
            v_cmd[:, j] = mean_held(channels[f"v_cmd.{joint}"], told)
        if f"tau_ff.{joint}" in channels:
            given[:, j] = mean_held(channels[f"tau_ff.{joint}"], told)
    return Drives(given, q_cmd, v_cmd, limit, on, gain, damping, voltage)


def roll_outs(model: ArmModel, runs: Sequence[tuple[Run, str]]) -> tuple[RollOut, ...]:
    """The motion errors of a model in recordings, each with its role; none of what cannot be simulated."""
    found, theta = [], model.theta()
    for run, role in runs:
        if not can_roll_out(model, run):
            continue
        whole = closed(model, run)
        for length in (np.inf,) if whole else WINDOWS:
            parts = windows(run, model.arm.joints, length)
            with np.errstate(all="ignore"):  # what is torn away by a torque that nothing resists ends nowhere
                errors = np.vstack([rolled(model, theta, part) - part.q for part in parts])
            time, measured = np.concatenate([part.time for part in parts]), np.vstack([part.q for part in parts])
            time, once = np.unique(time, return_index=True)
            for j, joint in enumerate(model.arm.joints):
                kind = "closed_loop" if whole else f"window_{length:g}"
                own, aside = errors[:, j], _aside(run, joint)
                there = bool(np.all(np.abs(own) < LOST))
                q = run.channels[f"q.{joint}"]
                told = run.channels[f"q_cmd.{joint}"].held(time) if aside is not None else None
                found.append(
                    RollOut(
                        run.name, role, kind, joint, q.unit,
                        _rms(own) if there else None, float(np.abs(own).mean()) if there else None, aside,
                        resolution(q.value),
                        time, measured[once, j], (errors + measured)[once, j], told,
                    )
                )  # fmt: skip
    return tuple(found)


def resolution(values: np.ndarray) -> float:
    """Step of the encoder that gave (n,) values; 0 where their differences are no multiples of one."""
    differences = np.abs(np.diff(values))
    moved = np.sort(differences[differences > ROUNDING])
    if not len(moved):
        return 0.0
    step = float(np.median(moved / np.round(moved / moved[0])))
    left = np.abs(moved / step - np.round(moved / step))
    return step if np.quantile(left, 0.9) < 0.1 else 0.0


def _aside(run: Run, joint: str) -> tuple[float, float] | None:
    if f"q_cmd.{joint}" not in run.channels:
        return None
    q = run.channels[f"q.{joint}"]
    error = run.channels[f"q_cmd.{joint}"].held(q.time) - q.value
    return _rms(error), float(np.abs(error).mean())


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
