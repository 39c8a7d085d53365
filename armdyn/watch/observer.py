r"""The observer: it takes one sample at a time and returns the residual of each channel with little delay.

The channels are the joints' torques and the axes of force/torque sensors. With the low-pass F = (K / (s + K))^3 the
residual of a channel tau is

    r = F[tau] - R(q_f, v_f, a_f),    q_f = F[q],  v_f = s F[q],  a_f = s^2 F[q],

where R is what the model predicts. This is the residual of the momentum observer (De Luca & Mattone, ICRA
2005), in which torque and motion pass the same low-pass and nothing is differentiated. Here F has order 3 instead of 1:
the positions then also give speed and acceleration, and effects that depend on acceleration are included. An outside
torque appears in r after the delay of F, 3 / K on average. The contrast c = r - b removes slow errors: b is the running
mean of r over the last `RUNNING_MEAN_SECONDS`.

A torque that began a moment ago is hardly visible behind F. So the torque passes a second cascade of low-passes with
the bandwidth `LOW_PASS_STAGE_BANDWIDTH`, and the prediction passes a third one; their outputs are the stages. At t s
after a unit step of torque, its stages hold the cdf of Erlang variables, and those of the prediction hold zero.
`armdyn.watch.onset` finds the weighted sum of the stages that shows a step best.

Where a joint reverses, F smooths the step of its friction. The kernel of F has the variance 3 / K^2, so that with the
acceleration a_f the expected sign of the velocity is erf(v_f / sqrt(2 (CREEP^2 + 3 a_f^2 / K^2))).
"""

from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.arm.composition import depends_on_past
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import CREEP_SPEED
from armdyn.arm.physics import Expression
from armdyn.arm.slots import slots_of
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.arm.wrench.symbolic import needs_more_than_an_instant, sensor_reading
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.coverage import Skipped

FILTER_ORDER = 3
"""Order of the low-pass F of torque and motion: the lowest that gives an acceleration."""
RUNNING_MEAN_SECONDS = 0.5
"""Memory of the running mean, s: half the shortest contact that a person notices, less than half a typical motion."""
MAX_SAMPLE_GAP_SECONDS = 0.2
"""Longest time between two samples, s; after a longer one the motion in between is unknown and the filters restart."""
SETTLING_TIME_CONSTANTS = 15.0
"""Time constants 1 / K after which F has forgotten its initial state: exp(-15) 15^2 / 2 = 3e-5 of it remain."""
CANDIDATE_BANDWIDTHS = (30.0, 40.0, 55.0, 75.0)
"""Candidates for K, 1/s; fault-free recordings select one. Neighbours detect torques that differ by less than 10 %."""
DEFAULT_OBSERVER_BANDWIDTH, MAX_BANDWIDTH_TIMES_INTERVAL = 40.0, 0.8
"""Bandwidth K of the low-pass F, 1/s, without fault-free recordings; and the largest product of K and the interval
between samples."""
INTERVALS_FOR_SAMPLING_RATE = 20
"""Number of intervals from which the sampling rate is estimated."""
IMPOSSIBLE_EFFORTS, LARGEST_EFFORT = 10.0, 1e4
"""Multiple of a drive's effort limit that no sensor reads, and limit of a drive that states none, N m or N."""
MAX_DETECTION_SECONDS = 0.05
"""Time within which an outside torque should be detected, s."""
LOW_PASS_STAGE_BANDWIDTH, TORQUE_LOW_PASS_STAGES, PREDICTION_LOW_PASS_STAGES = 100.0, 8, 5
"""Bandwidth of the stages, 1/s; number of low-passes for torque, and for prediction. On three simulated arms 6 and 3
low-passes detect 2 of 20 steps fewer in time; 60 1/s detects as many."""
RESIDUAL_MEAN_STATE_INDEX = 2 * (FILTER_ORDER + 1)
"""Index of the running mean of the residual in the state, in blocks of nj."""
FIRST_STAGE_STATE_INDEX = RESIDUAL_MEAN_STATE_INDEX + 6
"""Index of the first stage in the state, in blocks of nj."""
STATES_PER_JOINT = FIRST_STAGE_STATE_INDEX + TORQUE_LOW_PASS_STAGES + 1 + PREDICTION_LOW_PASS_STAGES
"""States per joint: last position and its 3 stages of F; the same for its torque; running means of residual, of
prediction without dry friction and of the dry friction; prediction a moment ago; friction of unknown value; time apart
from reversals, s; stages of torque; prediction and its stages. An axis of a sensor has all but those of the position.
The last entry of the state is the time since the start, s."""
REVERSAL_SHARE = 0.05
"""Share of the dry friction's size that its uncertain part has near a reversal, until F has forgotten it
(0.12 s for K = 75 1/s)."""
VARIANCE_SOURCE_COUNT = 4
"""Number of sources of a residual's variance, see `ObserverOutput.sources`."""


class ObserverOutput(NamedTuple):
    """Output of the observer for one sample, nj joints and nc channels, see `WatchedChannels`; delayed by F.

    Torques are in N m or N, as forces are.

    Attributes:
        time: time of the sample, s.
        predicted: (nc,) torque that the model predicts.
        residual: (nc,) measured minus predicted torque.
        contrast: (nc,) residual minus its running mean.
        sources: (nc, 4) terms that the error's variance is a sum of, with a factor each, (N m)^2 except the first: 1
            (noise); the squared deviations of the prediction without dry friction, and of the dry friction, from their
            running means (errors of links and gains, and of friction); the squared change of the prediction during the
            delay of F (errors of time).
        sticking: (nc,) dry friction of unknown value: what it leaves in the residual has any value up to this size.
        friction: (2, nc) dry friction that the model predicts, and its running mean.
        motion: (3, nj) filtered positions, rad or m, speeds and accelerations.
        stages: (nc, 14) stages of torque; prediction and its stages.
        settled: whether filters and mean have forgotten their initial state.
    """

    time: float
    predicted: FloatArray
    residual: FloatArray
    contrast: FloatArray
    sources: FloatArray
    sticking: FloatArray
    friction: FloatArray
    motion: FloatArray
    stages: FloatArray
    settled: bool


class Observer:
    """Computes residuals of the torques from one sample at a time.

    A gap, a jump of the clock or an impossibly fast change of position restarts its filters.

    Args:
        model: the arm.
        bandwidth: K, 1/s; reduced where the sampling rate is too low for it.
        channels: the channels; None for all of the arm's.

    Attributes:
        bandwidth: K in use, 1/s.
        mean_is_held: whether the running mean of the residual is held constant, as during an outside torque.
    """

    def __init__(
        self, model: ArmModel, bandwidth: float = DEFAULT_OBSERVER_BANDWIDTH, channels: WatchedChannels | None = None
    ) -> None:
        channels = WatchedChannels.of(model) if channels is None else channels
        self._joints, self._channels, self._asked = len(channels.joints), len(channels.names), channels.asked
        self._function = compiled_observer(model, channels)
        self._fastest = 2.0 * np.nan_to_num(np.asarray(model.arm.model.velocityLimit), nan=np.inf, posinf=np.inf)
        self._fastest[self._fastest <= 0.0] = np.inf
        effort = np.asarray(model.arm.model.effortLimit)
        effort = np.where(np.isfinite(effort) & (effort > 0.0), effort, LARGEST_EFFORT)
        sensed = np.full(self._channels - self._joints, LARGEST_EFFORT)
        self._strongest = IMPOSSIBLE_EFFORTS * np.concatenate([effort, sensed])
        self._state = np.zeros(_block(STATES_PER_JOINT, self._joints, self._channels) + 1)
        self._last: tuple[float, FloatArray] | None = None
        self._intervals: list[float] = []
        self.bandwidth = bandwidth
        self.mean_is_held = False

    def restart(self) -> None:
        """Restart the filters at the next sample."""
        self._last = None

    def process_sample(
        self, time: float, q: FloatArray, tau: FloatArray, shift: FloatArray | float = 0.0
    ) -> ObserverOutput | Skipped:
        """Process one sample; return the residuals, or why there are none.

        Args:
            time: time of the sample, s.
            q: (nj,) positions, rad or m.
            tau: (nc,) measured torques, N m or N.
            shift: (nc,) torque of changes that were reported before, which is subtracted from the residual.
        """
        tau = np.where(self._asked, tau, 0.0)
        if not np.isfinite(time):
            return Skipped.NO_TIME
        if not ((np.abs(tau) <= self._strongest).all() and np.isfinite(q).all()):
            return self._reason(q, tau)
        step = 0.0
        if self._last is not None:
            step = time - self._last[0]
            if step == 0.0 or (step < 0.0 and step > -MAX_SAMPLE_GAP_SECONDS):
                return Skipped.NOT_LATER
            if (np.abs(q - self._last[1]) > self._fastest * abs(step)).any() or (
                step > 0.0 and len(self._intervals) < INTERVALS_FOR_SAMPLING_RATE and self._too_rarely(step)
            ):
                step = 0.0
        self._last, K = (time, np.array(q)), self.bandwidth
        found = self._function(
            self._state, step, float(self.mean_is_held), K, q, tau, np.broadcast_to(shift, tau.shape)
        )
        self._state = found[0][:, 0].copy()
        predicted, residual, contrast = (part[:, 0].copy() for part in found[1:4])
        settled = bool(self._state[-1] > settling_time(K))
        first = _block(FIRST_STAGE_STATE_INDEX, self._joints, self._channels)
        stages = self._state[first:-1].reshape(-1, self._channels).T
        sources, sticking, friction, motion = (part.copy() for part in found[4:])
        return ObserverOutput(
            time, predicted, residual, contrast, sources, sticking[:, 0], friction.T, motion.T, stages, settled
        )

    def _too_rarely(self, step: float) -> bool:
        """Whether the sampling rate is too low for the filter; then K is reduced."""
        self._intervals.append(step)
        enough = len(self._intervals) == INTERVALS_FOR_SAMPLING_RATE
        slower = MAX_BANDWIDTH_TIMES_INTERVAL / float(np.median(self._intervals)) if enough else np.inf
        self.bandwidth, before = min(self.bandwidth, slower), self.bandwidth
        return self.bandwidth < before

    def restart_mean(self, residual: FloatArray) -> None:
        """Restart the running mean of the residual at (nc,) values, after a change was added to the model."""
        begin = _block(RESIDUAL_MEAN_STATE_INDEX, self._joints, self._channels)
        self._state[begin : begin + self._channels] = residual

    def _reason(self, q: FloatArray, tau: FloatArray) -> Skipped:
        """Why a sample with these positions (nj,) and torques (nc,) cannot be watched."""
        known, torques = np.isfinite(tau), np.isfinite(tau[: self._joints]).all()
        if not np.isfinite(q).all():
            return Skipped.NO_POSITION if known.all() else Skipped.NO_VALUE
        return Skipped.IMPOSSIBLE if known.all() else Skipped.NO_WRENCH if torques else Skipped.NO_TORQUE

    @property
    def delay(self) -> float:
        """Mean delay of the observer's filter, s."""
        return FILTER_ORDER / self.bandwidth


def _block(index: int, joints: int, channels: int) -> int:
    """Where a block of the state begins: those of the positions have one entry for each joint."""
    of_positions = min(index, FILTER_ORDER + 1)
    return of_positions * joints + (index - of_positions) * channels


def settling_time(bandwidth: float) -> float:
    """Time after a start until filters and mean have forgotten their initial state, s; bandwidth in 1/s."""
    return SETTLING_TIME_CONSTANTS / bandwidth + RUNNING_MEAN_SECONDS


def visible_share_of_step(bandwidth: float) -> float:
    """Share of a step of outside torque in the residual after `MAX_DETECTION_SECONDS`, at K = `bandwidth`, 1/s."""
    x = bandwidth * MAX_DETECTION_SECONDS
    return float(1.0 - np.exp(-x) * (1.0 + x + x**2 / 2.0))


def observer_function(model: ArmModel, channels: WatchedChannels) -> ca.Function:
    """One step of the observer, whose equations stand at the top of this module.

    ``(state, step, hold, bandwidth, q, tau, shift) -> (state, predicted, residual, contrast, sources, sticking,
    friction, motion)``; a
    `step` <= 0 or > `MAX_SAMPLE_GAP_SECONDS`, in s, restarts the filters, and `hold` = 1 holds the running mean
    constant. For shapes and units see `ObserverOutput`.

    Raises:
        InputError: an effect depends on time or has states; a function of one instant cannot contain it.
    """
    joints, n = len(channels.joints), len(channels.names)
    sizes = {"state": _block(STATES_PER_JOINT, joints, n) + 1, "q": joints, "tau": n, "shift": n}
    state, q, tau, shift = (ca.SX.sym(name, size) for name, size in sizes.items())
    step, hold, K = (ca.SX.sym(name) for name in ("step", "hold", "bandwidth"))
    parts = [state[_block(k, joints, n) : _block(k + 1, joints, n)] for k in range(STATES_PER_JOINT)]
    fresh = ca.logic_or(step <= 0.0, step > MAX_SAMPLE_GAP_SECONDS)
    h = ca.if_else(fresh, 1.0, step)
    past = parts[: FILTER_ORDER + 1], parts[FILTER_ORDER + 1 : RESIDUAL_MEAN_STATE_INDEX]
    position, torque = (_filtered(signal, states, K, h, fresh) for signal, states in zip((q, tau), past, strict=True))
    x1, x2, x3 = position[1:]
    v, a = K * (x2 - x3), K**2 * (x1 - 2.0 * x2 + x3)
    predicted, smooth, friction, way = predicted_reading(model, channels, x3, v, a, K)
    way = ca.vertcat(way, ca.SX.ones(n - joints))
    residual = torque[-1] - predicted - shift
    mean, expected, rubbed, before, doubted, seen = parts[RESIDUAL_MEAN_STATE_INDEX:FIRST_STAGE_STATE_INDEX]
    early = parts[FIRST_STAGE_STATE_INDEX:]
    torques = _filtered(
        tau, [parts[FILTER_ORDER + 1], *early[:TORQUE_LOW_PASS_STAGES]], LOW_PASS_STAGE_BANDWIDTH, h, fresh
    )[1:]
    predictions = _filtered(predicted, early[TORQUE_LOW_PASS_STAGES:], LOW_PASS_STAGE_BANDWIDTH, h, fresh)
    age = ca.if_else(fresh, 0.0, state[-1] + h)
    young = age <= SETTLING_TIME_CONSTANTS / K
    before = ca.if_else(fresh, predicted, before + (1.0 - ca.exp(-h * K / FILTER_ORDER)) * (predicted - before))
    # The friction of a reversal stays in the filters for a while.
    doubt = ca.fmax(friction * ca.sqrt(ca.fmax(1.0 - way**2, 0.0)), ca.exp(-h * K / FILTER_ORDER) * doubted)
    doubt = ca.if_else(fresh, friction, doubt)
    # Where a joint may stick, its friction has any value: the mean follows only what no friction explains. Elsewhere it
    # is that of the samples there, as soon as there are any.
    near = doubt > REVERSAL_SHARE * friction
    seen = ca.if_else(young, 0.0, seen + ca.if_else(near, 0.0, h))
    memory = ca.if_else(near, RUNNING_MEAN_SECONDS, ca.fmax(ca.fmin(seen - h, RUNNING_MEAN_SECONDS), 1e-9))
    share = ca.if_else(hold > 0.5, 0.0, 1.0 - ca.exp(-h / memory))
    mean = ca.if_else(young, 0.0, mean)
    further = ca.sign(residual - mean) * ca.fmax(ca.fabs(residual - mean) - ca.if_else(near, doubt, 0.0), 0.0)
    mean += ca.if_else(young, 1.0, share) * further
    # A share of a torque leaves in the contrast what the torque differs from its own mean, of the same memory.
    share = ca.if_else(young, 1.0, ca.if_else(near, 0.0, share))
    expected, rubbed = expected + share * (smooth - expected), rubbed + share * (predicted - smooth - rubbed)
    following = ca.vertcat(*position, *torque, mean, expected, rubbed, before, doubt, seen, *torques, *predictions, age)
    rubs = ca.horzcat(predicted - smooth, rubbed)
    changes = smooth - expected, predicted - smooth - rubbed, predicted - before
    sources = ca.horzcat(ca.SX.ones(n), *(change**2 for change in changes))
    outputs = [following, predicted, residual, residual - mean, sources, doubt, rubs, ca.horzcat(x3, v, a)]
    return ca.Function(
        "watch", [state, step, hold, K, q, tau, shift], [ca.densify(each) for each in outputs],
        ["state", "step", "hold", "bandwidth", "q", "tau", "shift"],
        ["state_next", "predicted", "residual", "contrast", "sources", "sticking", "friction", "motion"],
    )  # fmt: skip


def compiled_observer(model: ArmModel, channels: WatchedChannels) -> PreallocatedFunction:
    """The `observer_function` of a model, compiled if a C compiler is installed."""
    functions = {"watch": observer_function(without_past_dependent_effects(model), channels)}
    return PreallocatedFunction(compile_functions(f"watch_{len(channels.names)}", functions)["watch"])


def without_past_dependent_effects(model: ArmModel) -> ArmModel:
    """The model without effects whose torque depends on the past; a sensor's drift does not go on for ever either.

    Raises:
        InputError: an effect has states of its own, which the observer cannot contain.
    """
    late = {effect.name for effect in model.effects if depends_on_past(effect)}
    for effect in model.named_effects:
        if effect.name in late and not slots_of(effect).delays:  # shorter than F remembers
            raise InputError(
                f"effect '{effect.name}' has a state of its own, which a watch of single samples lacks: repair the "
                "model without it"
            )
    late |= {e.name for e in model.effects if e.acts_on == "wrench" and needs_more_than_an_instant(e)}
    return model.with_only_effects({effect.name for effect in model.effects} - late)


def _filtered(
    given: Expression, past: list[Expression], K: Expression, h: Expression, fresh: Expression
) -> list[Expression]:
    """Input and stages of a cascade after h s, each stage exact for an input that is linear between samples."""
    decay = ca.exp(-K * h)
    ramp = (1.0 - decay) / (K * h)
    following = [given]
    for before, own in pairwise(past):
        moved = decay * own + (ramp - decay) * before + (1.0 - ramp) * following[-1]
        following.append(ca.if_else(fresh, given, moved))
    return following


def predicted_reading(
    model: ArmModel, channels: WatchedChannels, q: Expression, v: Expression, a: Expression, K: Expression
) -> tuple[Expression, Expression, Expression, Expression]:
    """Predicted torques, without and size of the dry friction in them, (nc,) each; (nj,) signs of the velocities.

    Args:
        model: the arm.
        channels: the channels.
        q: (nj,) positions behind F, rad or m.
        v: (nj,) velocities.
        a: (nj,) accelerations.
        K: bandwidth of F, 1/s.
    """
    creep = ca.DM([0.1 * CREEP_SPEED if slides else CREEP_SPEED for slides in model.arm.slides])
    way = ca.erf(v / ca.sqrt(2.0 * (creep**2 + FILTER_ORDER * (a / K) ** 2)))
    links = [ca.SX(link) for link in model.link_parameters().values()]
    load, ones = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a), ca.SX.ones(way.numel())
    theta = ca.SX(model.theta())
    added, gain, offset = torques_added_by_effects(model, (q, v, a), way, load, ones, theta)
    signs = [torques_added_by_effects(model, (q, v, a), sign * ones, load, ones, theta)[0] for sign in (1, -1)]
    smooth = gain * (load + (signs[0] + signs[1]) / 2.0) + offset
    friction = ca.fabs(gain * (signs[0] - signs[1])) / 2.0
    sensed = ca.vertcat(*(sensor_reading(model, name, (q, v, a)) for name in channels.sensors))
    predicted, smooth = (ca.vertcat(own, sensed) for own in (gain * (load + added) + offset, smooth))
    return predicted, smooth, ca.vertcat(friction, ca.SX.zeros(sensed.numel())), way
