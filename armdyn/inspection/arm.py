"""Compare an arm's recording with its model, for every hypothesis on a mistake in the recording or the description."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.composition import depends_on_past
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import Motion, measured_motion
from armdyn.arm.prepared import samples_inside_motion
from armdyn.arm.rigid import inverse_dynamics
from armdyn.effects.effect import Effect
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.description import AS_DESCRIBED, DescriptionCorrection, with_sign_of_total
from armdyn.inspection.evidence import (
    MIN_MODEL_ERROR_SHARE_OF_RMS,
    ChannelReadings,
    EffectSizes,
    ReadingSums,
    evidence,
    independent_sample_share,
)
from armdyn.inspection.kinematics import local_averages
from armdyn.linear.solve import solve_bounded
from armdyn.object_cache import cached_with_first_argument
from armdyn.run import Run

ARM_EVALUATION_TIMES = 120
"""Number of moments at which a recording is evaluated: enough to distinguish a hundred effects of an arm."""
COARSE_EVALUATION_TIME_STRIDE = 2
"""Stride of the moments that the coarse evaluation of hypotheses uses."""
TORQUE_AVERAGE_HALF_WIDTH_SECONDS = 0.03
"""Half the time over which the torque at a moment is averaged, s."""
SEPARATELY_HANDLED_EFFECTS = frozenset(
    {"torque_delay", "base_tilt", "payload", "joint_asymmetric_friction", "joint_stribeck_friction", "joint_coupling"}
)
"""Effects whose columns the inspection of an arm computes itself in another form (a delay, a tilt, a payload), or that
are close to other effects."""
SIGN_ESTIMATION_ROUNDS = 3
"""Number of iterations that estimate the signs of torques that were recorded without sign."""
NEARLY_ZERO_SHARE_OF_EFFORT_LIMIT = 0.02
"""Share of a joint's effort limit below which its torques are nearly zero."""
USUAL_TORQUE_DELAY_SECONDS, MAX_TORQUE_DELAY_SECONDS = 0.03, 0.1
"""Usual delay of recorded torques, and the shift of a clock, s, from which on it is a mistake."""
USUAL_BASE_TILT_RADIANS, MIN_MOUNTING_ANGLE = 0.1, np.deg2rad(12.0)
"""Usual tilt of an arm's base, and least angle between gravity and its description for an arm on a wall or ceiling, rad; a
smaller angle is an effect, a tilted base."""
USUAL_PAYLOAD_SHARE_OF_ARM_MASS, USUAL_PAYLOAD_DISTANCE_METRES = 0.15, 0.2
"""Mass of a typical payload, as a share of the arm's mass, and its distance from the hand, m."""
INERTIAL_POWERS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""Power of length in the unit of each inertial parameter of a body: mass, first moments, second moments."""
USUAL_DRIVE_TORQUES_PER_EFFORT = np.array([0.05, 0.1, 0.1, 0.01])
"""Typical offset, viscous friction, dry friction and rotor inertia of a joint, as shares of its effort limit at 1 rad/s
and 1 rad/s^2."""
MIN_EFFORT_LIMIT_MEANING_NONE = 1e4
"""Effort limit, N m or N, from which on a description is taken to state no limit at all."""
LIMIT_VIOLATION_PRICE_NATS = 10.0
"""Log odds, in nats, against a hypothesis, for each joint that would leave its limits."""
IMPOSSIBLE_POSITION_LIMIT_EXCESS, IMPOSSIBLE_POSITION_PRICE_NATS = 4.0 * np.pi, 20.0
"""Excess over a position limit, rad or m, that is impossible for every joint, and the log odds against it, in nats."""
JOINT_POSITION_LIMIT_TOLERANCE, MAX_TORQUE_TO_EFFORT_LIMIT_RATIO = 0.3, 2.0
"""Excess over a position limit, rad or m, that is tolerated, and largest possible ratio of a torque to the effort
limit."""
DRIVE_PRIOR_INFORMATION = 0.05
"""Prior information on a joint's offset and frictions, in typical sizes, where gravity is fitted with them: the torques
then count over their mean square."""
IGNORED_LIMIT_EXCESS_TIME_SHARE = 0.05
"""Share of the moments beyond a limit up to which the limit does not count as exceeded."""


RecordingHypothesis: TypeAlias = tuple[Correction, DescriptionCorrection]
"""A hypothesis on a recording: its correction, and the correction of the arm's description."""
Readings: TypeAlias = tuple[tuple[str, CorrectedReading], ...]
"""Corrected readings, each with the name of its channel."""


@dataclass(frozen=True, eq=False)
class SampledArmRun:
    """A recording of an arm at a few moments, which is compared with the arm's model.

    Args:
        model: the model with its effects.
        run: the recording, without a gap.
        effects: further effects that the model may lack.
    """

    model: ArmModel
    run: Run
    effects: tuple[Effect, ...] = field(default=())

    def corrected(self, correction: Correction) -> "SampledArmRun":
        """The recording with a correction."""
        return replace(self, run=correction.applied_to(self.run))

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the torque channels of the recording."""
        return self.model.predicted_channels(self.run)

    @cached_property
    def joint_indices(self) -> np.ndarray:
        """(J,) index of the joint of each torque channel."""
        return np.array([self.model.arm.joints.index(c.removeprefix("tau.")) for c in self.channels])

    @cached_property
    def motion(self) -> Motion:
        """The recorded motion at the compared moments."""
        whole = measured_motion(self.run, self.model.arm.joints)
        first = self.run.channels[self.channels[0]]
        inside = first.time[samples_inside_motion(first, whole)]
        inside = inside if len(inside) > 1 else first.time
        return whole.at(np.linspace(inside[0], inside[-1], ARM_EVALUATION_TIMES))

    def torque(self, channel: str, late: float = 0.0, pace: float = 0.0) -> np.ndarray:
        """(n,) averages of a recorded torque around the moments, N m or N.

        The stamps are corrected by a delay `late`, s, and a relative error `pace` of the clock's rate.
        """
        recorded = self.run.channels[channel]
        stamps = CorrectedReading(channel, delay=late, clock_rate_error=pace).stamps_at(
            self.motion.time, float(recorded.time[0])
        )
        return local_averages(recorded, stamps, TORQUE_AVERAGE_HALF_WIDTH_SECONDS)

    @cached_property
    def measured(self) -> np.ndarray:
        """(J, n) recorded torques at the moments, N m or N."""
        return np.array([self.torque(channel) for channel in self.channels])

    def corrected_motion(self, correction: Correction) -> Motion:
        """The motion at the moments after a correction of the recording."""
        m = self.motion
        if not any(name.startswith("q.") for name in correction.readings):
            return m
        joints = self.model.arm.joints
        readings = [correction.reading(f"q.{joint}") for joint in joints]
        source = [joints.index(r.source.removeprefix("q.")) for r in readings]
        factor, offset = (np.array([getattr(r, part) for r in readings]) for part in ("factor", "offset"))
        pace = 1.0 + self._pace(correction)
        q, v, a = (factor * pace**k * values[:, source] for k, values in enumerate((m.q, m.v, m.a)))
        return Motion(m.time / pace, q + offset, v, a, np.sign(factor) * m.direction[:, source])

    def _pace(self, correction: Correction) -> float:
        """Relative error of the rate of the positions' clock."""
        return correction.reading(f"q.{self.model.arm.joints[0]}").clock_rate_error

    @cached_property
    def weights(self) -> np.ndarray:
        """(J,) number of independent samples per recorded sample of each torque."""
        given = self._readings(Correction(), AS_DESCRIBED, np.full(len(self.channels), 0.3))
        residual = given.residual(evidence(given.sums).sizes)
        return independent_sample_share(self.measured, residual, self._nearly_zero)

    @cached_property
    def _nearly_zero(self) -> np.ndarray:
        """(J,) recorded torques that are nearly zero."""
        limits = self._effort[self.joint_indices]
        # Where every torque is nearly zero, such as a motor's before its gear, the largest is the measure.
        largest = float(np.max(np.sqrt(np.mean(self.measured**2, axis=1)) / limits))
        return np.asarray(min(NEARLY_ZERO_SHARE_OF_EFFORT_LIMIT, largest) * limits)

    def corrected_torques(self, correction: Correction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(J, n) torques after a correction, (J,) logarithms of its factors, (J,) indices of its source channels."""
        asked = [correction.reading(channel) for channel in self.channels]
        readings = [
            r if r.source in self.channels else CorrectedReading(channel)
            for r, channel in zip(asked, self.channels, strict=True)
        ]
        sources = np.array([self.channels.index(r.source) for r in readings])
        own = 1.0 + self._pace(correction)
        paces = [(1.0 + r.clock_rate_error) / own - 1.0 for r in readings]
        recorded = [
            self.torque(r.source, r.delay, pace) if r.delay or pace else self.measured[source]
            for r, source, pace in zip(readings, sources, paces, strict=True)
        ]
        factor, offset = np.array([(r.factor, r.offset) for r in readings]).T
        return factor[:, None] * np.array(recorded) + offset[:, None], np.log(np.abs(factor)), sources

    def described_torques(self, motion: Motion, description: DescriptionCorrection = AS_DESCRIBED) -> np.ndarray:
        """(J, n) torques of the model for a motion, with a correction of its description."""
        changed = description.corrected_model(self.model.arm.model)
        if self._own.effects:
            found = self._own.at_states(MotionSamples(changed, motion, motion.time))[0]
        else:
            found = inverse_dynamics(changed, motion.q, motion.v, motion.a)
        return np.asarray(found.T[self.joint_indices]) - (self._weight(motion) if description.compensated else 0.0)

    def _weight(self, motion: Motion) -> np.ndarray:
        """(J, n) torques that hold the weight of the arm as described."""
        still = np.zeros_like(motion.q)
        return np.asarray(inverse_dynamics(self.model.arm.model, motion.q, still, still).T[self.joint_indices])

    @cached_property
    def price_of_positions(self) -> float:
        """Price in nats of the recorded positions beyond the joints' limits."""
        return self._beyond(self.motion)

    def _beyond(self, motion: Motion) -> float:
        """Price in nats of positions beyond the joints' limits."""
        described = self.model.arm.model
        excess = np.maximum(described.lowerPositionLimit - motion.q, motion.q - described.upperPositionLimit)
        tolerances = (
            (JOINT_POSITION_LIMIT_TOLERANCE, LIMIT_VIOLATION_PRICE_NATS),
            (IMPOSSIBLE_POSITION_LIMIT_EXCESS, IMPOSSIBLE_POSITION_PRICE_NATS),
        )
        return sum(price * float(np.count_nonzero(_mostly(excused < excess.T))) for excused, price in tolerances)

    def _too_strong(self, torques: np.ndarray) -> np.ndarray:
        """(...) price in nats of (..., J, n) torques that no drive of this arm has."""
        limit = MAX_TORQUE_TO_EFFORT_LIMIT_RATIO * self.model.arm.model.effortLimit[self.joint_indices, None]
        return LIMIT_VIOLATION_PRICE_NATS * np.count_nonzero(_mostly(np.abs(torques) > limit), axis=-1)

    def coarse_log_evidence(self, meanings: Sequence[RecordingHypothesis]) -> np.ndarray:
        """(h,) approximate log evidence of hypotheses, nats, in a hundredth of the time of `log_evidence`.

        Every joint has friction, a rotor, an offset and a model error of a tenth of its torque. Changes of inertia,
        springs and payloads are left out.
        """
        read = [self.corrected_torques(correction) for correction, _ in meanings]
        coarse = [
            self._coarse(tuple(sorted((n, r) for n, r in c.readings.items() if n.startswith("q."))), description)
            for c, description in meanings
        ]
        y, log_factor = (
            np.array([r[0][:, ::COARSE_EVALUATION_TIME_STRIDE] for r in read]),
            np.array([r[1] for r in read]),
        )
        weight = np.array([self.weights[r[2]] for r in read])
        described, X, cost = (np.array(part) for part in zip(*coarse, strict=True))
        scale = np.maximum(np.mean(y**2, axis=2), self._min_rms(log_factor) ** 2)
        gap = y - described
        turned = np.swapaxes(X, 2, 3)
        G, slope = turned @ X, (turned @ gap[..., None])[..., 0]
        variance, lower = 0.1 * scale, np.array([-np.inf, 0.0, 0.0, 0.0])
        for _ in range(2):
            A = G / variance[..., None, None] + np.eye(X.shape[3])
            theta = solve_bounded(A, slope / variance[..., None], lower, np.inf).x
            residual = gap - (X @ theta[..., None])[..., 0]
            variance = np.mean(residual**2, axis=2) + MIN_MODEL_ERROR_SHARE_OF_RMS**2 * scale
        total = len(self.motion.time) * np.sum(weight * (log_factor - 0.5 * np.log(variance)), axis=1)
        return np.asarray(total - cost - self._too_strong(y))

    @cached_with_first_argument
    def _coarse(
        self, positions: Readings, description: DescriptionCorrection
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """At some moments (J, n) torques, (J, n, 4) columns of the drives, and the price of the positions."""
        m = self.corrected_motion(Correction(dict(positions)))
        m = Motion(*(x[::COARSE_EVALUATION_TIME_STRIDE] for x in (m.time, m.q, m.v, m.a, m.direction)))
        described, columns = description.as_recorded(m.time, self.described_torques(m, description), self._of_drives(m))
        return described, columns, self._beyond(m)

    def _of_drives(self, m: Motion) -> np.ndarray:
        """(J, n, 4) torques of offset, viscous and dry friction, and rotor, of typical size."""
        columns = np.stack([np.ones(m.q.shape), m.v, m.direction, m.a], axis=2).transpose(1, 0, 2)
        return (columns * self._effort[:, None, None] * USUAL_DRIVE_TORQUES_PER_EFFORT)[self.joint_indices]

    def _min_rms(self, log_factor: np.ndarray) -> np.ndarray:
        """(..., J) torques that are nearly zero, for (..., J) logarithms of the factors on the recorded ones."""
        return np.asarray(self._nearly_zero * np.exp(log_factor))

    def sums(self, correction: Correction, description: DescriptionCorrection = AS_DESCRIBED) -> ReadingSums:
        """What the evidence of a hypothesis needs of this recording, with every effect that may be present."""
        return self._sums(tuple(sorted(correction.readings.items())), description)

    @cached_with_first_argument
    def _sums(self, readings: Readings, description: DescriptionCorrection) -> ReadingSums:
        correction = Correction(dict(readings))
        *_, source = self.corrected_torques(correction)
        return self._readings(correction, description, self.weights[source]).sums

    def _readings(
        self, correction: Correction, description: DescriptionCorrection, weight: np.ndarray
    ) -> ChannelReadings:
        """Readings and predictions for a hypothesis, with (J,) independent samples per sample."""
        m = self.corrected_motion(correction)
        y, log_factor, _ = self.corrected_torques(correction)
        if m is self.motion and description == AS_DESCRIBED:
            f, columns, sizes = self._linear_as_described
        else:
            samples = MotionSamples(description.corrected_model(self.model.arm.model), m, m.time)
            f, columns, sizes = self._linear(samples, description.mass * description.length)
            f = f - self._weight(m) if description.compensated else f
            f, columns = description.as_recorded(m.time, f, columns)
        price = -self._beyond(m) - float(self._too_strong(y))

        def given() -> ChannelReadings:
            floor = self._min_rms(log_factor)
            return ChannelReadings(y, f, columns, sizes, weight, log_factor, floor, log_odds=price)

        for _ in range(
            SIGN_ESTIMATION_ROUNDS if description.magnitudes else 0
        ):  # the effects also decide the sign of a torque
            f, columns = with_sign_of_total(f + columns @ evidence(given().sums).sizes, f, columns)
        return given()

    @cached_property
    def gravity_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3) and (3,) normal equations of gravity in the base's frame, m/s^2, with friction and offsets."""
        m, y = self.motion, self.measured
        gap = y - self.described_torques(m, DescriptionCorrection((0.0, 0.0, 0.0)))
        X = np.concatenate([self._per_gravity(m), self._of_drives(m)[:, :, :3]], axis=2)
        return self._beside_drives(X, gap)

    @cached_property
    def inertial_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """(1, 1) and (1,) normal equations of a factor on all inertial torques, with friction and offsets."""
        m, weight = self.motion, self._weight(self.motion)
        inertial = self.described_torques(m) - weight
        X = np.concatenate([inertial[:, :, None], self._of_drives(m)[:, :, :3]], axis=2)
        return self._beside_drives(X, self.measured - weight)

    def _beside_drives(self, X: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(g, g) and (g,) normal equations of the first of (J, n, g + 3) columns; the last are those of the drives."""
        turned = np.swapaxes(X, 1, 2) / np.maximum(np.mean(self.measured**2, axis=1), 1e-12)[:, None, None]
        G, slope = turned @ X, (turned @ gap[..., None])[..., 0]
        onto = np.linalg.solve(G[:, -3:, -3:] + DRIVE_PRIOR_INFORMATION * np.eye(3), G[:, -3:, :-3])
        alone = np.sum(G[:, :-3, :-3] - G[:, :-3, -3:] @ onto, axis=0)
        return alone, np.sum(slope[:, :-3], axis=0) - np.einsum("jkg,jk->g", onto, slope[:, -3:])

    def _per_gravity(self, m: Motion) -> np.ndarray:
        """(J, n, 3) derivatives of the torques by gravity."""
        return MotionSamples(self.model.arm.model, m, m.time).per_gravity.described[self.joint_indices]

    @cached_property
    def _effort(self) -> np.ndarray:
        """(nj,) effort limits of the joints, N m or N, or, where none is given, the torques that hold the arm."""
        limits = np.array(self.model.arm.model.effortLimit)
        held = np.abs(inverse_dynamics(self.model.arm.model, self.motion.q, self.motion.v, self.motion.a)).max(axis=0)
        return np.where(limits < MIN_EFFORT_LIMIT_MEANING_NONE, limits, 2.0 * held + 1e-6)

    @cached_property
    def _own(self) -> ArmModel:
        """The model with those of its effects whose torque depends only on the present moment."""
        return self.model.with_only_effects([e.name for e in self.model.effects if not depends_on_past(e)])

    @cached_property
    def _extended(self) -> tuple[ArmModel, np.ndarray, EffectSizes]:
        """The model with all effects at null; (p,) typical sizes; prior knowledge on the sizes, also of `_linear`'s."""
        model = self._own.with_fixed_null_effects(
            [e for e in self.effects if not (e.name in SEPARATELY_HANDLED_EFFECTS or depends_on_past(e))]
        )
        parameters = list(model.parameters.values())
        size = np.array([p.typical for p in parameters])
        value = np.array([p.value for p in parameters])
        # A link that loses all of its mass weighs nothing.
        lower = np.array([max(p.lower, -1.0) if p.effect == "link_inertia" else p.lower for p in parameters])
        upper = np.array([p.upper for p in parameters])
        effects = [*dict.fromkeys(p.effect for p in parameters), "payload", "base_tilt", "torque_delay"]
        nj, none = len(self.model.arm.joints), np.full(len(INERTIAL_POWERS) - 1, np.inf)
        tilt = np.sin(MIN_MOUNTING_ANGLE) / USUAL_BASE_TILT_RADIANS
        late = MAX_TORQUE_DELAY_SECONDS / USUAL_TORQUE_DELAY_SECONDS
        beside = np.concatenate([[1.0 / USUAL_PAYLOAD_SHARE_OF_ARM_MASS], none, np.full(3, tilt), np.full(nj, late)])
        of_beside = np.repeat(len(effects) + np.array([-3, -2, -1]), [len(INERTIAL_POWERS), 3, nj])
        return model, size, EffectSizes(
            np.concatenate([[effects.index(p.effect) for p in parameters], of_beside]).astype(int),
            np.concatenate([(lower - value) / size, [0.0], -beside[1:]]),
            np.concatenate([(upper - value) / size, beside]),
        )

    def columns_of_effect(self, effect: str) -> np.ndarray:
        """(p,) bool, the unknowns of the evidence that belong to an effect."""
        model, _, sizes = self._extended
        own = [p.effect == effect for p in model.parameters.values()]
        return np.pad(np.array(own, dtype=bool), (0, len(sizes.kind) - len(own)))

    @cached_property
    def _linear_as_described(self) -> tuple[np.ndarray, np.ndarray, EffectSizes]:
        return self._linear(MotionSamples(self.model.arm.model, self.motion, self.motion.time), 1.0)

    def _linear(self, stretch: MotionSamples, heavier: float) -> tuple[np.ndarray, np.ndarray, EffectSizes]:
        """(J, n) torques, (J, n, p) columns times typical sizes, and prior knowledge on the (p,) sizes."""
        model, size, sizes = self._extended
        m = stretch.motion
        torques, derivatives = model.at_states(stretch)
        described = torques.T[self.joint_indices]
        # A link changes by shares of its mass and extent, which the description may have wrong.
        size = np.where([p.effect == "link_inertia" for p in model.parameters.values()], heavier * size, size)
        own = (derivatives * size).transpose(1, 0, 2)[self.joint_indices]
        load = max(1.0, USUAL_PAYLOAD_SHARE_OF_ARM_MASS * heavier * float(self.model.arm.described[:, 0].sum()))
        carried = load * USUAL_PAYLOAD_DISTANCE_METRES**INERTIAL_POWERS
        payload = (stretch.regressor[:, :, -1] * carried).transpose(1, 0, 2)[self.joint_indices]
        tilt = self._per_gravity(m) * (USUAL_BASE_TILT_RADIANS * float(np.linalg.norm(self.model.gravity())))
        late = USUAL_TORQUE_DELAY_SECONDS * np.gradient(described, m.time, axis=1)
        delays = late[:, :, None] * np.eye(len(self.model.arm.joints))[self.joint_indices][:, None]
        return described, np.concatenate([own, payload, tilt, delays], axis=2), sizes


def _mostly(beyond: np.ndarray) -> np.ndarray:
    """(...) whether more than a few of (..., n) moments are beyond a limit."""
    return np.asarray(beyond.mean(axis=-1) > IGNORED_LIMIT_EXCESS_TIME_SHARE)
