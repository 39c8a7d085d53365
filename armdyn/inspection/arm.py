"""Compare an arm's recording with its model, for every hypothesis on a mistake in the recording or the description."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import MIN_CERTAIN_VELOCITY_SIGN, Motion, measured_motion
from armdyn.arm.prepared import samples_inside_motion
from armdyn.arm.rigid import inverse_dynamics
from armdyn.estimation.solve import inverse_positive, solve_bounded
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
from armdyn.inspection.missing_effects import MissingEffects
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.run import Run

ARM_EVALUATION_TIMES = 120
"""Number of moments at which a recording is evaluated: enough to distinguish a hundred effects of an arm."""
COARSE_EVALUATION_TIME_STRIDE = 2
"""Stride of the moments that the coarse evaluation of hypotheses uses."""
TORQUE_AVERAGE_HALF_WIDTH_SECONDS = 0.03
"""Half the time over which the torque at a moment is averaged, s."""
SOON_PERIODS = 1.0 / 12.0
"""Part of a motion's period in which its torque hardly changes, so that what changes is noise or vibration."""
SIGN_ESTIMATION_ROUNDS = 3
"""Number of iterations that estimate the signs of torques that were recorded without sign."""
NEARLY_ZERO_SHARE_OF_EFFORT_LIMIT = 0.02
"""Share of a joint's effort limit below which its torques are nearly zero."""
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
        effects: the model, and the effects that it may lack.
        run: the recording, without a gap.
    """

    effects: MissingEffects
    run: Run

    @property
    def model(self) -> ArmModel:
        """The model with its effects."""
        return self.effects.model

    def corrected(self, correction: Correction) -> "SampledArmRun":
        """The recording with a correction."""
        return replace(self, run=correction.applied_to(self.run))

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the torque channels of the recording."""
        return tuple(self.model.force_channels(self.run))

    @cached_property
    def joint_indices(self) -> np.ndarray:
        """(J,) index of the joint of each torque channel."""
        return np.array([self.model.arm.joints.index(joint) for joint in self.model.force_channels(self.run).values()])

    @cached_property
    def motion(self) -> Motion:
        """The recorded motion at the compared moments."""
        whole = measured_motion(self.run, self.model.arm.joints)
        first = self.run.channels[self.channels[0]]
        inside = first.time[samples_inside_motion(first, whole)]
        inside = inside if len(inside) > 1 else first.time
        found = whole.at(np.linspace(inside[0], inside[-1], ARM_EVALUATION_TIMES))
        # At rest friction has no direction that the recording tells.
        known = np.abs(found.direction) >= MIN_CERTAIN_VELOCITY_SIGN
        return replace(found, direction=np.where(known, found.direction, 0.0))

    @cached_with_first_argument
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
        # Moments are far apart in a long recording: a fast motion is another one at the next moment.
        after = [self._soon_after(self.run.channels[channel]) for channel in self.channels]
        return independent_sample_share(self.measured, residual, self._nearly_zero, np.array(after))

    def _soon_after(self, recorded: Channel) -> np.ndarray:
        """(n,) averages of a recorded torque a short part of the motion's period later, N m or N.

        They have no sample in common with those around the moments, and are no later than the next moment.
        """
        m = self.motion
        period = 2.0 * np.pi * float(np.sqrt(np.sum(m.v**2) / max(float(np.sum(m.a**2)), 1e-300)))
        apart = 2.0 * max(TORQUE_AVERAGE_HALF_WIDTH_SECONDS, 2.0 * float(np.median(np.diff(recorded.time))))
        later = np.clip(SOON_PERIODS * period, apart, max(apart, float(m.time[1] - m.time[0])))
        return local_averages(recorded, m.time + later, TORQUE_AVERAGE_HALF_WIDTH_SECONDS)

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
        if self.effects.own.effects:
            found = self.effects.own.at_states(MotionSamples(changed, motion, motion.time))[0]
        else:
            found = inverse_dynamics(changed, motion.q, motion.v, motion.a)
        return np.asarray(found.T[self.joint_indices]) - (self._weight(motion) if description.compensated else 0.0)

    def _weight(self, motion: Motion) -> np.ndarray:
        """(J, n) torques that hold the weight of the arm as described."""
        still = np.zeros_like(motion.q)
        return np.asarray(inverse_dynamics(self.model.arm.model, motion.q, still, still).T[self.joint_indices])

    @cached_property
    def cost_of_positions(self) -> float:
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
    def _coarse(self, positions: Readings, description: DescriptionCorrection) -> tuple[np.ndarray, np.ndarray, float]:
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
        onto = inverse_positive(G[:, -3:, -3:] + DRIVE_PRIOR_INFORMATION * np.eye(3)) @ G[:, -3:, :-3]
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

    def _linear(self, stretch: MotionSamples, heavier: float) -> tuple[np.ndarray, np.ndarray, EffectSizes]:
        """(J, n) torques, (J, n, p) columns times typical sizes, and prior knowledge on the (p,) sizes."""
        described, columns = self.effects.linear(stretch, heavier)
        return described[self.joint_indices], columns[self.joint_indices], self.effects.sizes

    @cached_property
    def _linear_as_described(self) -> tuple[np.ndarray, np.ndarray, EffectSizes]:
        return self._linear(MotionSamples(self.model.arm.model, self.motion, self.motion.time), 1.0)


def _mostly(beyond: np.ndarray) -> np.ndarray:
    """(...) whether more than a few of (..., n) moments are beyond a limit."""
    return np.asarray(beyond.mean(axis=-1) > IGNORED_LIMIT_EXCESS_TIME_SHARE)
