"""Compare the simulated motion of an arm with its recorded motion; drives follow their commands or measured torques.

Where every joint has a position command, whole recordings are simulated from their first state in closed loop. Under
measured torques alone errors grow without limit, so short windows are simulated, each from the measured motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from armdyn.arm.closed_loop.play import play_sides, plays
from armdyn.arm.closed_loop.simulator import DriveInputs, simulate_arm
from armdyn.arm.control_laws import CONTROL_LAWS
from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import measured_motion
from armdyn.arm.readings import drive_signals
from armdyn.object_cache import cached_with_first_argument
from armdyn.run import Run

MAX_ROLLOUT_STEP_SECONDS, MAX_COARSE_ROLLOUT_STEP_SECONDS = 0.001, 0.004
"""Longest step of a simulation, s, and of one that only leads a fit near its optimum. In arms that stick and slide, the
error of the first is below an encoder's noise; that of the second is up to ten times larger and biases frictions."""
MAX_STEP_SHARE_OF_SERVO_TIME = 2.0
"""Longest step as a share of sqrt(I/k), the time in which a servo with gain k pulls back an inertia I."""
ROLLOUT_WINDOW_SECONDS = (0.5, 5.0)
"""Lengths of the windows of recordings that cannot be simulated as a whole, s."""
MIN_ENCODER_STEP = 1e-6
"""Size of a difference, rad or m, below which it is rounding of the file and not an encoder's step."""
MAX_ROLLOUT_ERROR = 2.0 * np.pi
"""Error, rad or m, beyond which a simulated joint has left the motion; its size has then no meaning."""
INTEGRAL_EFFECT = "servo_integral"
"""Effect for which a window's drives have summed up their torques before it."""
MAX_FALL_STEP_SECONDS = 0.01
"""Longest step, s, of a link's fall through its play."""
SAMPLED_LOADS = 50
"""Number of moments of a window whose loads say which of them are small."""
SETTLING_SECONDS, MAX_SETTLING_SHARE = 0.5, 0.05
"""Beginning of a recording that is not simulated, s, and the largest share of it: a velocity is smoothed from one side
there, and a command may have begun to move just then, so that a simulation would begin with a wrong velocity."""
TORQUE_DELAY_PARAMETER, COMMAND_DELAY_PARAMETER = "torque_delay.time", "command_delay.time"
"""Parameters that delay a measured torque, and the action of a command."""


@dataclass(frozen=True)
class SimulatedPositionError:
    """Error of one joint's simulated position in one run.

    Attributes:
        run: name of the run.
        role: ``"training"``, ``"held_out"`` or ``"exam"``.
        kind: ``"closed_loop"``, or ``"window_0.5"`` and ``"window_5"``.
        joint: name of the joint.
        unit: rad or m.
        rms: root mean square of the error; None where the error exceeds `MAX_ROLLOUT_ERROR`.
        mae: mean absolute error, likewise.
        position_is_command: both errors of a joint that is always at its command; None without a position command.
        resolution: step of the encoder; 0 where none is visible.
        time: (n,) time stamps of the positions, s, increasing.
        measured: (n,) measured positions.
        simulated: (n,) simulated positions.
        told: (n,) commanded positions; None without a position command.
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


def _commanded(servo: Servo | None, run: Run, joint: str) -> bool:
    """Whether a joint has a drive with a known gain, and the run contains its command."""
    return servo is not None and servo.gain is not None and servo.command(joint) in run.channels


def has_all_position_commands(model: ArmModel, run: Run) -> bool:
    """Whether a run contains a position command of every joint of the arm."""
    servos = {joint: model.servo(joint) for joint in model.arm.joints}
    return all(s is not None and s.control.holds_position and s.command(j) in run.channels for j, s in servos.items())


def can_simulate_motion(model: ArmModel, run: Run) -> bool:
    """Whether the run contains a command or a torque of every joint, and no effect has states of its own."""
    driven = (f"tau.{j}" in run.channels or _commanded(model.servo(j), run, j) for j in model.arm.joints)
    return not model.arm.carried and not model.remembers and all(driven)


@dataclass(frozen=True, eq=False)
class SimulationWindow:
    """Part of a recording that is simulated from its first state.

    Attributes:
        run: the recording.
        begin: start time, s.
        end: end time, s.
        start: (nj,) positions and (nj,) velocities at the start.
        time: (n,) time stamps of the recorded positions, s.
        q: (n, nj) recorded positions.
    """

    run: Run
    begin: float
    end: float
    start: tuple[np.ndarray, np.ndarray]
    time: np.ndarray
    q: np.ndarray


@dataclass(frozen=True, eq=False)
class SimulatedWindow:
    """Simulated motion of a window.

    Attributes:
        edges: (n + 1,) times, s, at equal distances.
        q: (n + 1, nj) positions.
        v: (n + 1, nj) velocities.
    """

    edges: np.ndarray
    q: np.ndarray
    v: np.ndarray

    def links_at(self, model: ArmModel, theta: np.ndarray, time: np.ndarray) -> np.ndarray:
        """(n, nj) simulated joint positions, rad or m, behind the plays of the gears, at (n,) increasing times, s."""
        q, way = self._at(time, self.q), np.array(plays(model, theta))
        return q - way * self.sides_at(model, theta, time) if np.any(way > 0.0) else q

    def sides_at(self, model: ArmModel, theta: np.ndarray, time: np.ndarray) -> np.ndarray:
        """(n, nj) ends of their plays at which the links hang at (n,) increasing times, s; see `play_sides`."""
        way, at = np.array(plays(model, theta)), time
        if np.any(way > 0.0):  # between the samples, links fall through their plays
            every = max(1, int(MAX_FALL_STEP_SECONDS / (self.edges[1] - self.edges[0])))
            at = self.edges[::every]
        place, v = self._at(at, self.q), self._at(at, self.v)
        a = np.gradient(v, at, axis=0) if len(at) > 1 else np.zeros_like(v)
        found = play_sides(model, theta, (place, v, a), at)
        return np.column_stack([np.interp(time, at, found[:, j]) for j in range(found.shape[1])])

    def _at(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(time, self.edges, values[:, j]) for j in range(values.shape[1])])


@cached_with_first_argument
def simulation_windows(run: Run, joints: tuple[str, ...], length: float) -> tuple[SimulationWindow, ...]:
    """Parts of a recording of `length` s each, or the whole recording for infinite `length`, with start states."""
    motion = measured_motion(run, joints)
    first = run.channels[f"q.{joints[0]}"].time
    settled = min(SETTLING_SECONDS, MAX_SETTLING_SHARE * (motion.end - motion.start))
    time = first[(first >= motion.start + settled) & (first <= motion.end)]
    measured = np.column_stack(
        [np.interp(time, run.channels[f"q.{j}"].time, run.channels[f"q.{j}"].value) for j in joints]
    )
    lasts = float(time[-1] - time[0])
    count = 1 if lasts <= length else int(lasts / length)
    edges = time[0] + np.arange(count + 1) * min(length, lasts)
    found = []
    for begin, end in pairwise(edges):
        inside = (time >= begin - 1e-9) & (time <= end + 1e-9)
        at = motion.at(np.array([begin]))
        found.append(
            SimulationWindow(run, float(begin), float(end), (at.q[0], at.v[0]), time[inside], measured[inside])
        )
    return tuple(found)


def simulated_positions(
    model: ArmModel,
    theta: np.ndarray,
    window: SimulationWindow,
    servos: Sequence[Servo | None] | None = None,
    longest: float = MAX_ROLLOUT_STEP_SECONDS,
) -> np.ndarray:
    """(n, nj) simulated positions at the stamps of a window.

    Args:
        model: the arm.
        theta: (p,) parameters.
        window: the part that is simulated.
        servos: drives by joint; None means those of the model.
        longest: longest step of the simulation, s.
    """
    own = [model.servo(joint) for joint in model.arm.joints] if servos is None else list(servos)
    found = simulate_window(model, theta, window, own, longest)
    return found.links_at(model, theta, window.time)


def simulate_window(
    model: ArmModel, theta: np.ndarray, window: SimulationWindow, servos: Sequence[Servo | None], longest: float
) -> SimulatedWindow:
    """Simulate a window from its first state; see `simulated_positions`."""
    step = min(longest, _stiff_step(model, theta, servos))
    count = max(1, int(np.ceil((window.end - window.begin) / step - 1e-9)))
    edges = window.begin + step * np.arange(count + 1)
    start = window.start
    way = np.array(plays(model, theta))
    if np.any(way > 0.0):  # the start is that of the links, which is not where the drives are
        start = (start[0] + way * start_sides(model, theta, window), start[1])
    q, v = simulate_arm(model, theta, start, drive_inputs(model, theta, window.run, servos, edges), step)
    return SimulatedWindow(edges, q, v)


def start_sides(model: ArmModel, theta: np.ndarray, window: SimulationWindow) -> np.ndarray:
    """(nj,) ends of their plays at which the links hang at the start of a window; see `play_sides`."""
    return play_sides(model, theta, _sampled_motion(window, model.arm.joints))[0]


@cached_with_first_argument
def _sampled_motion(window: SimulationWindow, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured positions, velocities and accelerations of a window at `SAMPLED_LOADS` moments."""
    at = measured_motion(window.run, joints).at(np.linspace(window.begin, window.end, SAMPLED_LOADS))
    return at.q, at.v, at.a


def _stiff_step(model: ArmModel, theta: np.ndarray, servos: Sequence[Servo | None]) -> float:
    """Longest step, s, that resolves how each position servo pulls its joint back; infinite without one."""
    rigid = model.rigid_body_model_at(theta)
    mass = np.diag(pin.crba(rigid, rigid.createData(), pin.neutral(rigid))).tolist()
    stiff = ((m, k) for m, s in zip(mass, servos, strict=True) if s and (k := s.feedback[0]) > 0.0)
    return min((MAX_STEP_SHARE_OF_SERVO_TIME * float(np.sqrt(inertia / k)) for inertia, k in stiff), default=np.inf)


def drive_inputs(
    model: ArmModel, theta: np.ndarray, run: Run, servos: Sequence[Servo | None], edges: np.ndarray
) -> DriveInputs:
    """Inputs of a simulation over the (n,) steps between `edges`, s; the recording tells what came before."""
    found = _drive_inputs(model, theta, run, servos, edges)
    if not any(effect.name == INTEGRAL_EFFECT for effect in model.effects):
        return found
    step = float(edges[1] - edges[0])
    earlier, q, v = _motion_before(run, model.arm.joints, float(edges[0]), step)
    if len(earlier) < 2:
        return found
    summed = _drive_inputs(model, theta, run, servos, earlier).integrands(q, v)
    return replace(found, total=summed.sum(axis=0) * step)


@cached_with_first_argument
def _motion_before(
    run: Run, joints: tuple[str, ...], begin: float, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges of the steps of a recording up to `begin`, s, and measured positions and velocities in their middles."""
    motion = measured_motion(run, joints)
    earlier = begin + step * np.arange(-max(int((begin - motion.start) / step + 1e-9), 0), 1)
    at = motion.at((earlier[1:] + earlier[:-1]) / 2.0)
    return earlier, at.q, at.v


def _drive_inputs(
    model: ArmModel, theta: np.ndarray, run: Run, servos: Sequence[Servo | None], edges: np.ndarray
) -> DriveInputs:
    """See `drive_inputs`; as if nothing came before."""
    channels, values = run.channels, dict(zip(model.names, theta.tolist(), strict=True))
    laws = [CONTROL_LAWS["torque"] if servo is None else servo.control for servo in servos]
    drives, middle = DriveInputs.off(len(edges) - 1, laws), (edges[1:] + edges[:-1]) / 2
    for j, (joint, servo) in enumerate(zip(model.arm.joints, servos, strict=True)):
        if servo is None or servo.gain is None or not _commanded(servo, run, joint):
            time, torque = middle + values.get(f"{TORQUE_DELAY_PARAMETER}[{joint}]", 0.0), channels[f"tau.{joint}"]
            drives.signals.share[:, j] = 1.0
            drives.signals.feed[:, j] = np.interp(time, torque.time, torque.value)
            continue
        when = edges - (servo.delay or 0.0) - values.get(f"{COMMAND_DELAY_PARAMETER}[{joint}]", 0.0)
        drives.voltage[:, j] = servo.relative_excess_voltage(run, joint, middle)
        told = drive_signals(run, joint, servo, middle, when)
        for whole, own in zip(drives.signals.all, told.all, strict=True):
            whole[:, j] = own
    return drives


def simulated_position_errors(model: ArmModel, runs: Sequence[tuple[Run, str]]) -> tuple[SimulatedPositionError, ...]:
    """Errors of the simulated motion in recordings, each with its role; without those that cannot be simulated."""
    found, theta = [], model.theta()
    for run, role in runs:
        if not can_simulate_motion(model, run):
            continue
        whole = has_all_position_commands(model, run)
        for length in (np.inf,) if whole else ROLLOUT_WINDOW_SECONDS:
            parts = simulation_windows(run, model.arm.joints, length)
            with np.errstate(all="ignore"):  # under a torque that nothing resists positions become infinite
                errors = np.vstack([simulated_positions(model, theta, part) - part.q for part in parts])
            measured = np.vstack([part.q for part in parts])
            time, once = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
            for j, joint in enumerate(model.arm.joints):
                q, command = run.channels[f"q.{joint}"], run.channels.get(f"q_cmd.{joint}")
                rms, mae = _sizes(errors[:, j]) if np.all(np.abs(errors[:, j]) < MAX_ROLLOUT_ERROR) else (None, None)
                found.append(
                    SimulatedPositionError(
                        run.name, role, "closed_loop" if whole else f"window_{length:g}", joint, q.unit, rms, mae,
                        None if command is None else _sizes(command.zero_order_hold_values(q.time) - q.value),
                        encoder_step(q.value),
                        time, measured[once, j], (errors + measured)[once, j],
                        None if command is None else command.zero_order_hold_values(time),
                    )
                )  # fmt: skip
    return tuple(found)


def encoder_step(values: np.ndarray) -> float:
    """Step of the encoder that gave (n,) values; 0 where their differences are not multiples of one."""
    differences = np.abs(np.diff(values))
    moved = np.sort(differences[differences > MIN_ENCODER_STEP])
    if not len(moved):
        return 0.0
    step = float(np.median(moved / np.round(moved / moved[0])))
    remainder = np.abs(moved / step - np.round(moved / step))
    return step if np.quantile(remainder, 0.9) < 0.1 else 0.0


def _sizes(errors: np.ndarray) -> tuple[float, float]:
    """Root mean square and mean absolute value."""
    return float(np.sqrt(np.mean(errors**2))), float(np.abs(errors).mean())
