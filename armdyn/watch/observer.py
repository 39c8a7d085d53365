r"""An arm's model beside the arm: one sample in, and what the drives read beyond it out, with little delay.

With F = (K / (s + K))^3 the residual of joint j is

    r = F[tau] - R(q_f, v_f, a_f),    q_f = F[q],  v_f = s F[q],  a_f = s^2 F[q],

R what the model says that the drive reads. It is the momentum observer's residual (De Luca & Mattone, ICRA 2005: torque
and motion pass one low-pass, so that nothing is differentiated) with a filter of third order in place of the first:
positions alone then give speed and acceleration, and whatever an effect makes of the acceleration is counted in. A
torque from outside appears in it after F's delay, 3 / K on average. What changes slowly is taken off by a running mean
of the last `SLOW` s: c = r - b, the contrast.

What began a moment ago is hardly in F's output yet, and one filter for all drives would be too slow for some. So a
second cascade has the torque, and another one the prediction, behind 1, 2, ... low-passes of `EARLY` 1/s: `stages`. A
step of torque of 1 after t s is the cdf of an Erlang variable in the torque's and nothing in the prediction's; which
sum of the stages shows it best over what a sound robot does, `armdyn.watch.onset` finds.

Where a joint turns round, F smooths the step of its friction. F's kernel has the variance 3 / K^2, so that with the
acceleration a_f the expected sign of the velocity is erf(v_f / sqrt(2 (CREEP^2 + 3 a_f^2 / K^2))).
"""

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from armdyn.arm.composition import depends_on_before
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import CREEP
from armdyn.arm.physics import Expression
from armdyn.arm.symbolic import added_torques, rigid_torques
from armdyn.codegen import Buffered, compile_functions
from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray

ORDER = 3
"""Of F: the least that gives an acceleration."""
SLOW = 0.5
"""s; half of what an outside torque lasts at least that a person notices, and less than half a usual motion."""
GAP = 0.2
"""s without a sample after which nobody knows how the arm moved in between: the filters begin anew."""
SETTLED = 15.0
"""Time constants of F after which what it began with is gone: exp(-15) 15^2 / 2 is 3e-5 of it."""
BANDWIDTHS = (30.0, 40.0, 55.0, 75.0)
"""K, 1/s, of which sound recordings choose, see `arrived`; neighbours find torques within 10 % of each other."""
USUAL, PER_SAMPLE = 40.0, 0.8
"""K where there are none, and at most so much of it for each interval between samples."""
FIRST = 20
"""Intervals that say how often samples come."""
SOON = 0.05
"""s in which a torque from outside should be found."""
EARLY, TORQUES, PREDICTIONS = 100.0, 8, 5
"""1/s, and low-passes for torque and prediction. On three simulated arms 6 and 3 find 2 of 20 steps fewer in time, and
60 1/s as many."""
SHORT = frozenset({"torque_delay", "command_delay"})
"""Effects with a memory that is shorter than F's own."""
MEAN = 2 * (ORDER + 1)
"""Where the mean of the residual stands."""
STAGES = MEAN + 4
"""Where the cascades of `EARLY` stand."""
PARTS = STAGES + TORQUES + 1 + PREDICTIONS
"""States of a joint: last input and stages of F for its position, likewise its torque, means of residual and of
prediction, the prediction a moment ago, and doubt; then stages of torque, the prediction and its stages; then the
age."""
SOURCES = 4
"""Of a residual's variance, see `Step`: noise, errors of links and gains, of time, and of friction's direction."""


@dataclass(frozen=True, eq=False)
class Step:
    """What one sample says, of the nj joints; N m or N, as of the filter's delay ago.

    Attributes:
        time: of the sample, s.
        predicted: (nj,) that the model expects the drives to read.
        residual: (nj,) read, less that.
        contrast: (nj,) that of the last moments, less the mean before.
        sources: (nj, 4) what the error's variance may grow with, (N m)^2 but the first: 1; the square of what the
            prediction changed lately, as of an error of links; of what it changes during F's delay, as of an error of
            time; and of the dry friction whose direction is not known.
        motion: (3, nj) filtered positions, speeds and accelerations.
        stages: (nj, 14) of torque, the prediction and its stages, N m.
        settled: whether filters and mean hold nothing of how they began.
    """

    time: float
    predicted: FloatArray
    residual: FloatArray
    contrast: FloatArray
    sources: FloatArray
    motion: FloatArray
    stages: FloatArray
    settled: bool


class Observer:
    """Takes samples one by one; a gap, a clock that jumps or a position that no motion explains begins it anew.

    Args:
        model: an arm.
        bandwidth: K, 1/s, where the samples come often enough for it.

    Attributes:
        bandwidth: K, 1/s, as it is used.
        hold: whether the running mean must wait, as something acts that is not to be taken for usual.
    """

    def __init__(self, model: ArmModel, bandwidth: float = USUAL) -> None:
        self._joints = len(model.arm.joints)
        self._asked = np.array([joint in model.joints for joint in model.arm.joints])
        self._function = compiled(model)[0]
        self._fastest = 2.0 * np.nan_to_num(np.asarray(model.arm.model.velocityLimit), nan=np.inf, posinf=np.inf)
        self._fastest[self._fastest <= 0.0] = np.inf
        self._state = np.zeros(PARTS * self._joints + 1)
        self._last: tuple[float, FloatArray] | None = None
        self._intervals: list[float] = []
        self.bandwidth = bandwidth
        self.hold = False

    def begin(self) -> None:
        """What comes next follows nothing that was."""
        self._last = None

    def take(self, time: float, q: FloatArray, tau: FloatArray, shift: FloatArray | float = 0.0) -> Step | None:
        """One sample; None where it is no use: something is missing, or its stamp is not after the last one.

        Args:
            time: s.
            q: (nj,) positions.
            tau: (nj,) what the drives read.
            shift: (nj,) of it, what is known of by now.
        """
        tau = np.where(self._asked, tau, 0.0)
        if not (np.isfinite(time) and np.isfinite(q).all() and np.isfinite(tau).all()):
            return None
        step = 0.0
        if self._last is not None:
            step = time - self._last[0]
            if step == 0.0 or (step < 0.0 and step > -GAP):
                return None  # repeated, or overtaken by a later one
            if (np.abs(q - self._last[1]) > self._fastest * abs(step)).any() or (
                step > 0.0 and len(self._intervals) < FIRST and self._too_rarely(step)
            ):
                step = 0.0
        self._last, K = (time, np.array(q)), self.bandwidth
        found = self._function(self._state, step, float(self.hold), K, q, tau, np.broadcast_to(shift, q.shape))
        self._state = found[0][:, 0].copy()
        predicted, residual, contrast = (part[:, 0].copy() for part in found[1:4])
        settled = bool(self._state[-1] > settling(K))
        stages = self._state[STAGES * self._joints : -1].reshape(-1, self._joints).T
        return Step(time, predicted, residual, contrast, found[4].copy(), found[5].T.copy(), stages, settled)

    def _too_rarely(self, step: float) -> bool:
        """Whether samples turn out to come too rarely for the filter, which then becomes slower."""
        self._intervals.append(step)
        slower = PER_SAMPLE / float(np.median(self._intervals)) if len(self._intervals) == FIRST else np.inf
        self.bandwidth, before = min(self.bandwidth, slower), self.bandwidth
        return self.bandwidth < before

    def explained(self, residual: FloatArray) -> None:
        """Begin the running mean anew, with a residual (nj,): what the last moments held is known now."""
        self._state[MEAN * self._joints : (MEAN + 1) * self._joints] = residual

    @property
    def delay(self) -> float:
        """How long ago what is said now was on average, s."""
        return ORDER / self.bandwidth


def settling(bandwidth: float) -> float:
    """S after a start until filters and mean hold nothing of how they began."""
    return SETTLED / bandwidth + SLOW


def arrived(bandwidth: float) -> float:
    """Share of a torque from outside that the residual has after `SOON`, at K = `bandwidth`, 1/s."""
    x = bandwidth * SOON
    return float(1.0 - np.exp(-x) * (1.0 + x + x**2 / 2.0))


def observer_function(model: ArmModel) -> ca.Function:
    """A step of the observer of this module, for one sample.

    It is ``(state, step, hold, bandwidth, q, tau, shift) -> (state, predicted, residual, contrast, sources, motion)``;
    a `step` of 0, below it or above `GAP` begins anew, and `hold` of 1 keeps the mean.

    Raises:
        InputError: an effect depends on time or has states of its own, which no function of one instant has.
    """
    n = len(model.arm.joints)
    state, q, tau, shift = (ca.SX.sym(name, size) for name, size in
                            (("state", PARTS * n + 1), ("q", n), ("tau", n), ("shift", n)))  # fmt: skip
    step, hold, K = (ca.SX.sym(name) for name in ("step", "hold", "bandwidth"))
    parts = [state[k * n : (k + 1) * n] for k in range(PARTS)]
    fresh = ca.logic_or(step <= 0.0, step > GAP)
    h = ca.if_else(fresh, 1.0, step)
    position, torque = (_filtered(inputs, past, K, h, fresh) for inputs, past in
                        ((q, parts[: ORDER + 1]), (tau, parts[ORDER + 1 : 2 * ORDER + 2])))  # fmt: skip
    x1, x2, x3 = position[1:]
    v, a = K * (x2 - x3), K**2 * (x1 - 2.0 * x2 + x3)
    predicted, friction, way = _reading(model, x3, v, a, K)
    residual = torque[-1] - predicted - shift
    mean, expected, before, doubted = parts[MEAN:STAGES]
    early = parts[STAGES:]
    torques = _filtered(tau, [parts[ORDER + 1], *early[:TORQUES]], EARLY, h, fresh)[1:]
    predictions = _filtered(predicted, early[TORQUES:], EARLY, h, fresh)
    age = ca.if_else(fresh, 0.0, state[-1] + h)
    # Until it is as old as it remembers the mean is that of all since the filters settled.
    gain = 1.0 - ca.exp(-h / ca.fmax(ca.fmin(age - SETTLED / K, SLOW), 1e-9))
    young = age <= SETTLED / K
    mean = ca.if_else(young, residual, mean + ca.if_else(hold > 0.5, 0.0, gain) * (residual - mean))
    expected = ca.if_else(young, predicted, expected + gain * (predicted - expected))
    before = ca.if_else(fresh, predicted, before + (1.0 - ca.exp(-h * K / ORDER)) * (predicted - before))
    # What a joint did while it turned round is in the filters for a while.
    doubt = ca.fmax(friction * ca.sqrt(ca.fmax(1.0 - way**2, 0.0)), ca.exp(-h * K / ORDER) * doubted)
    doubt = ca.if_else(fresh, friction, doubt)
    following = ca.vertcat(*position, *torque, mean, expected, before, doubt, *torques, *predictions, age)
    changes = predicted - expected, predicted - before, doubt
    sources = ca.horzcat(ca.SX.ones(n), *(change**2 for change in changes))
    outputs = [following, predicted, residual, residual - mean, sources, ca.horzcat(x3, v, a)]
    return ca.Function(
        "watch", [state, step, hold, K, q, tau, shift], [ca.densify(each) for each in outputs],
        ["state", "step", "hold", "bandwidth", "q", "tau", "shift"],
        ["state_next", "predicted", "residual", "contrast", "sources", "motion"],
    )  # fmt: skip


def column_function(model: ArmModel) -> ca.Function:
    """``(q, v, a, bandwidth) -> (load, own, way)``: what changes would add to what the drives read.

    `load` (nj, 4) is per mass, kg, and mass times place, kg m, of what the last link carries more, in the frame of its
    joint; `own` (nj, 4) is, of each joint's own, per dry friction, N m, viscous friction, N m s/rad, torque that
    is read without any, N m, and share of the torque that is read too large; `way` (nj,) is the expected sign of
    each velocity.

    Raises:
        InputError: as `observer_function`.
    """
    n = len(model.arm.joints)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    K, more = ca.SX.sym("bandwidth"), ca.SX.sym("more", 4)
    links = [ca.SX(link) for link in model.link_parameters().values()]
    last = model.arm.joints.index(model.joints[-1])
    links[last] = ca.vertcat(links[last][:4] + more, links[last][4:])
    rigid = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
    load = ca.substitute(ca.jacobian(rigid, more), more, ca.SX.zeros(4))
    _, gain, offset = _torques(model, q, v, a, ca.SX.zeros(n), ca.SX.zeros(n))
    predicted, _, way = _reading(model, q, v, a, K)
    columns = ca.horzcat(gain * way, gain * v, ca.SX.ones(n), predicted - offset)
    outputs = [ca.densify(ca.diag(gain) @ load), ca.densify(columns), way]
    return ca.Function("columns", [q, v, a, K], outputs, ["q", "v", "a", "bandwidth"], ["load", "own", "way"])


def compiled(model: ArmModel) -> tuple[Buffered, Buffered]:
    """`observer_function` and `column_function`, as machine code where there is a compiler."""
    kept = without_memory(model)
    name = f"watch_{len(model.arm.joints)}"
    functions = {"watch": observer_function(kept), "columns": column_function(kept)}
    built = compile_functions(name, functions)
    return Buffered(built["watch"]), Buffered(built["columns"])


def without_memory(model: ArmModel) -> ArmModel:
    """The model without effects by which a torque depends on what was before.

    Raises:
        InputError: one that was named has states of its own.
    """
    late = {effect.name for effect in model.effects if depends_on_before(effect)}
    for effect in model.named_effects:
        if effect.name in late and effect.name not in SHORT:
            raise InputError(
                f"effect '{effect.name}' has a state of its own, which a watch of single samples lacks: repair the "
                "model without it"
            )
    return model.with_only({effect.name for effect in model.effects} - late)


def _filtered(
    given: Expression, past: list[Expression], K: Expression, h: Expression, fresh: Expression
) -> list[Expression]:
    """The input and the stages of F after h s, each stage exact for an input that is straight in between."""
    decay = ca.exp(-K * h)
    ramp = (1.0 - decay) / (K * h)
    following = [given]
    for before, own in pairwise(past):
        moved = decay * own + (ramp - decay) * before + (1.0 - ramp) * following[-1]
        following.append(ca.if_else(fresh, given, moved))
    return following


def _reading(
    model: ArmModel, q: Expression, v: Expression, a: Expression, K: Expression
) -> tuple[Expression, Expression, Expression]:
    """What the drives read, the size of the dry friction in it and the expected sign of the velocities, (nj,) each."""
    creep = ca.DM([0.1 * CREEP if slides else CREEP for slides in model.arm.slides])
    way = ca.erf(v / ca.sqrt(2.0 * (creep**2 + ORDER * (a / K) ** 2)))
    links = [ca.SX(link) for link in model.link_parameters().values()]
    load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
    added, gain, offset = _torques(model, q, v, a, load, way)
    signs = [_torques(model, q, v, a, load, sign * ca.SX.ones(len(model.arm.joints)))[0] for sign in (1, -1)]
    return gain * (load + added) + offset, ca.fabs(gain * (signs[0] - signs[1])) / 2.0, way


def _torques(
    model: ArmModel, q: Expression, v: Expression, a: Expression, load: Expression, way: Expression
) -> tuple[Expression, Expression, Expression]:
    return added_torques(model, (q, v, a), way, load, ca.SX.ones(len(model.arm.joints)), ca.SX(model.theta()))
