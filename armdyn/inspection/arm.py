"""Recordings of an arm against its description: torques at a few moments, in every way in which they may be meant."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.composition import depends_on_before
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import Motion, measured_motion
from armdyn.arm.prepared import interior
from armdyn.arm.rigid import inverse_dynamics
from armdyn.effects.effect import Effect
from armdyn.inspection.correction import Correction, Reading
from armdyn.inspection.evidence import FLOOR, Channels, Evidence, evidence, independent
from armdyn.inspection.kinematics import averages
from armdyn.linear.solve import solve_bounded
from armdyn.run import Run

MOMENTS = 120
"""At which a recording is looked at: as many as tell a hundred effects of an arm apart."""
COARSE = 2
"""Every which moment a first look is at."""
NEAR = 0.03
"""s to either side of a moment over which its torque is averaged."""
ASIDE = frozenset(
    {"torque_delay", "base_tilt", "payload", "joint_asymmetric_friction", "joint_stribeck_friction", "joint_coupling"}
)
"""Effects whose columns are made here in another form (a delay, a tilt, a payload), or are near those of others."""
LARGE = {"joint_viscous_friction": 3.0, "joint_coulomb_friction": 3.0, "rotor_inertia": 3.0, "gravity_spring": 2.0}
"""Times its typical size that an effect often has; Baxter's spring is 3.5 times as large as a spring typically is."""
SIGNS = 3
"""Times that the signs of torques of which only the sizes are known are decided anew."""
SLIGHT = 0.02
"""Of what a joint is made for: torques that are hardly any."""
LATE = 0.03
"""s by which torques are often late."""
TILT = 0.1
"""rad; of a base."""
LOAD, LEVER = 0.15, 0.2
"""Of the mass of the arm, and m: a payload and its place."""
BEYOND = 10.0
"""Nats for each joint that would leave its limits: descriptions have wrong limits now and then."""
FAR, NEVER = 4.0 * np.pi, 20.0
"""rad or m beyond a limit where no joint is, whatever its description says of limits, and nats that each costs."""
MARGIN, STRONGER = 0.3, 2.0
"""rad or m beyond a limit that is still at it, and times its effort that a joint has at most."""
SELDOM = 0.05
"""Share of the moments beyond a limit that says nothing."""


@dataclass(frozen=True)
class Description:
    """What may be wrong with a model's description rather than with a recording.

    Attributes:
        gravity: (3,) m/s^2 in the frame of the base; that of the model where None.
        mass: factor of all masses and inertias.
        length: factor of all lengths.
        lag: s; time constant with which the torques were low-passed.
        magnitudes: whether only the sizes of torques were written down.
        compensated: whether the weight of the arm as described was taken out of the torques, but not a payload's.
    """

    gravity: tuple[float, float, float] | None = None
    mass: float = 1.0
    length: float = 1.0
    lag: float = 0.0
    magnitudes: bool = False
    compensated: bool = False

    def of(self, model: pin.Model) -> pin.Model:
        """The arm so described."""
        if replace(self, lag=0.0, magnitudes=False, compensated=False) == Description():
            return model
        changed = model.copy()
        if self.gravity is not None:
            changed.gravity.linear = np.array(self.gravity)
        if self.length != 1.0:
            for i, placement in enumerate(list(model.jointPlacements)):
                changed.jointPlacements[i] = pin.SE3(placement.rotation, self.length * placement.translation)
        for i, inertia in enumerate(list(model.inertias)):
            lever, moment = self.length * inertia.lever, self.mass * self.length**2 * inertia.inertia
            changed.inertias[i] = pin.Inertia(self.mass * inertia.mass, lever, moment)
        return changed

    def read(self, time: np.ndarray, *parts: np.ndarray) -> tuple[np.ndarray, ...]:
        """Torques (J, n), and what changes them (J, n, k), as such a recording has them."""
        if self.lag:
            parts = tuple(_lagged(time, part, self.lag) for part in parts)
        return turned_up(parts[0], *parts) if self.magnitudes else parts


def turned_up(whole: np.ndarray, *parts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Parts (J, n, ...) of a torque (J, n), with its sign, so that the whole becomes its size."""
    sign = np.where(whole < 0.0, -1.0, 1.0)
    return tuple(sign.reshape(sign.shape + (1,) * (part.ndim - 2)) * part for part in parts)


def _lagged(time: np.ndarray, value: np.ndarray, lag: float) -> np.ndarray:
    """(J, n, ...) after a first-order lag, exact for what is straight between the times (n,)."""
    found = np.empty_like(value)
    found[:, 0] = value[:, 0]
    for k, h in enumerate(np.diff(time).tolist(), start=1):
        keep = np.exp(-h / lag)
        mean = lag / h * (1.0 - keep)
        found[:, k] = keep * found[:, k - 1] + (mean - keep) * value[:, k - 1] + (1.0 - mean) * value[:, k]
    return found


AS_DESCRIBED = Description()
NOTHING = Description(mass=0.0)
"""A description that says nothing."""


Meaning: TypeAlias = tuple[Correction, Description]
"""How a recording is to be read, and what it is held against."""
Positions: TypeAlias = tuple[tuple[str, Reading], ...]
"""How positions are to be read, by channel."""


@dataclass(frozen=True, eq=False)
class ArmRun:
    """One recording of an arm at a few moments.

    Args:
        model: with the effects that it has.
        run: as recorded, without a gap.
        effects: that may be missing.
    """

    model: ArmModel
    run: Run
    effects: tuple[Effect, ...] = field(default=())

    @property
    def joints(self) -> tuple[str, ...]:
        """Of the arm, whose torques are asked for."""
        return self.model.joints

    def slides(self, joint: str) -> bool:
        """Whether a joint slides."""
        return self.model.arm.slides[self.model.arm.joints.index(joint)]

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Torques that were recorded."""
        return self.model.predicted_channels(self.run)

    @cached_property
    def of_joint(self) -> np.ndarray:
        """(J,) index of each torque's joint."""
        return np.array([self.model.arm.joints.index(c.removeprefix("tau.")) for c in self.channels])

    @cached_property
    def motion(self) -> Motion:
        """As recorded, at the moments."""
        whole = measured_motion(self.run, self.model.arm.joints)
        first = self.run.channels[self.channels[0]]
        inside = first.time[interior(first, whole)]
        inside = inside if len(inside) > 1 else first.time
        return whole.at(np.linspace(inside[0], inside[-1], MOMENTS))

    def torque(self, channel: str, late: float = 0.0, pace: float = 0.0) -> np.ndarray:
        """(n,) averages of a torque around the moments, by how late and fast its stamps are."""
        recorded = self.run.channels[channel]
        stamps = Reading(channel, late=late, pace=pace).stamped(self.motion.time, float(recorded.time[0]))
        return averages(recorded, stamps, NEAR)

    @cached_property
    def measured(self) -> np.ndarray:
        """(J, n) torques as recorded."""
        return np.array([self.torque(channel) for channel in self.channels])

    def moved(self, correction: Correction) -> Motion:
        """The motion as a correction reads it."""
        m = self.motion
        if not any(name.startswith("q.") for name in correction.readings):
            return m
        joints = self.model.arm.joints
        readings = [correction.reading(f"q.{joint}") for joint in joints]
        source = [joints.index(r.source.removeprefix("q.")) for r in readings]
        factor, offset = (np.array([getattr(r, part) for r in readings]) for part in ("factor", "offset"))
        q, v, a = (factor * values[:, source] for values in (m.q, m.v, m.a))
        return Motion(m.time, q + offset, v, a, np.sign(factor) * m.direction[:, source])

    @cached_property
    def weights(self) -> np.ndarray:
        """(J,) independent samples per sample of the torques as recorded."""
        left = self.sure(Correction(), AS_DESCRIBED, np.full(len(self.channels), 0.3)).left
        return independent(self.measured, left, SLIGHT * self._effort[self.of_joint])

    def read(self, correction: Correction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(J, n) torques as a correction reads them, (J,) logarithms of how much larger they become, (J,) sources."""
        rows, volume = self.measured.copy(), np.zeros(len(self.channels))
        sources = np.arange(len(self.channels))
        for i, channel in enumerate(self.channels):
            r = correction.reading(channel)
            sources[i] = self.channels.index(r.source)
            if r.late or r.pace:
                rows[i] = r.factor * self.torque(r.source, r.late, r.pace) + r.offset
            elif r.source != channel or r.factor != 1.0 or r.offset:
                rows[i] = r.factor * self.measured[self.channels.index(r.source)] + r.offset
            volume[i] = np.log(abs(r.factor))
        return rows, volume, sources

    def described(self, motion: Motion, description: Description = AS_DESCRIBED) -> np.ndarray:
        """(J, n) torques of the model as it is, in its own or another description."""
        changed = description.of(self.model.arm.model)
        if self._own.effects:
            found = self._own.at_states(MotionSamples(changed, motion, motion.time))[0]
        else:
            found = inverse_dynamics(changed, motion.q, motion.v, motion.a)
        return np.asarray(found.T[self.of_joint]) - (self._weight(motion) if description.compensated else 0.0)

    def _weight(self, motion: Motion) -> np.ndarray:
        """(J, n) torques that hold the arm as described."""
        still = np.zeros_like(motion.q)
        return np.asarray(inverse_dynamics(self.model.arm.model, motion.q, still, still).T[self.of_joint])

    def outside(self, motion: Motion, torques: np.ndarray) -> float:
        """Nats that positions beyond the joints' limits cost, and (J, n) torques that no drive of this arm has."""
        return self._beyond(motion) + float(self._too_strong(torques))

    def _beyond(self, motion: Motion) -> float:
        described = self.model.arm.model
        below, above = described.lowerPositionLimit - motion.q, motion.q - described.upperPositionLimit
        beyond, far = ((np.maximum(below, above) > margin).mean(axis=0) > SELDOM for margin in (MARGIN, FAR))
        return BEYOND * float(np.count_nonzero(beyond)) + NEVER * float(np.count_nonzero(far))

    def _too_strong(self, torques: np.ndarray) -> np.ndarray:
        """(...) nats of (..., J, n) torques."""
        limit = STRONGER * self.model.arm.model.effortLimit[self.of_joint, None]
        return BEYOND * np.count_nonzero((np.abs(torques) > limit).mean(axis=-1) > SELDOM, axis=-1)

    def rough(self, meanings: Sequence[Meaning]) -> np.ndarray:
        """(h,) evidence without inertias, springs and payloads, of all meanings at once: a hundredth of the time.

        Every joint has friction, a rotor, an offset and an error of a tenth of its torque.
        """
        read = [self.read(correction) for correction, _ in meanings]
        coarse = [
            self._coarse(tuple(sorted((n, r) for n, r in c.readings.items() if n.startswith("q."))), description)
            for c, description in meanings
        ]
        y, volume = np.array([r[0][:, ::COARSE] for r in read]), np.array([r[1] for r in read])
        weight = np.array([self.weights[r[2]] for r in read])
        described, X, cost = (np.array(part) for part in zip(*coarse, strict=True))
        scale = np.maximum(np.mean(y**2, axis=2), (SLIGHT * self._effort[self.of_joint] * np.exp(volume)) ** 2)
        gap = y - described
        turned = np.swapaxes(X, 2, 3)
        G, slope = turned @ X, (turned @ gap[..., None])[..., 0]
        variance, lower = 0.1 * scale, np.array([-np.inf, 0.0, 0.0, 0.0])
        for _ in range(2):
            A = G / variance[..., None, None] + np.eye(X.shape[3])
            theta = solve_bounded(A, slope / variance[..., None], lower, np.inf).x
            left = gap - (X @ theta[..., None])[..., 0]
            variance = np.mean(left**2, axis=2) + FLOOR**2 * scale
        total = len(self.motion.time) * np.sum(weight * (volume - 0.5 * np.log(variance)), axis=1)
        return np.asarray(total - cost - self._too_strong(y))

    @cached_property
    def _coarse(self) -> Callable[[Positions, Description], tuple[np.ndarray, np.ndarray, float]]:
        """See `_coarse_of`; kept, as many meanings share it."""
        return cache(self._coarse_of)

    def _coarse_of(self, positions: Positions, description: Description) -> tuple[np.ndarray, np.ndarray, float]:
        """At some moments (J, n) torques and (J, n, 4) columns of offset, frictions and rotor; the cost of postures."""
        m = self.moved(Correction(dict(positions)))
        m = Motion(*(x[::COARSE] for x in (m.time, m.q, m.v, m.a, m.direction)))
        j, effort = self.of_joint, self._effort[self.of_joint]
        rows = [np.full(m.q.shape, 0.05)[:, j], 0.1 * m.v[:, j], 0.1 * m.direction[:, j], 0.01 * m.a[:, j]]
        columns = (np.stack(rows, axis=2) * effort[:, None]).transpose(1, 0, 2)
        described, columns = description.read(m.time, self.described(m, description), columns)
        return described, columns, self._beyond(m)

    def sure(
        self, correction: Correction, description: Description = AS_DESCRIBED, weight: np.ndarray | None = None
    ) -> Evidence:
        """Evidence with every effect that there may be."""
        m = self.moved(correction)
        y, volume, source = self.read(correction)
        weight = self.weights[source] if weight is None else weight
        if m is self.motion and description == AS_DESCRIBED:
            f, columns, positive = self._linear_as_described
        else:
            changed = description.of(self.model.arm.model)
            f, columns, positive = self._linear(
                MotionSamples(changed, m, m.time), description.mass * description.length
            )
            f = f - self._weight(m) if description.compensated else f
            f, columns = description.read(m.time, f, columns)
        least = SLIGHT * self._effort[self.of_joint] * np.exp(volume)
        found = evidence(Channels(y, f, columns, positive, weight, volume, least))
        for _ in range(SIGNS if description.magnitudes else 0):  # the effects decide, too, which way a torque acts
            f, columns = turned_up(f + columns @ found.sizes, f, columns)
            found = evidence(Channels(y, f, columns, positive, weight, volume, least))
        return Evidence(found.value - self.outside(m, y), found.left, found.share, found.sizes)

    def nothing(self) -> float:
        """Evidence of a description that says nothing: a mistake must explain more than that."""
        return self.sure(Correction(), NOTHING).value

    def with_run(self, run: Run) -> "ArmRun":
        """The same of another recording."""
        return replace(self, run=run)

    def gravity(self, correction: Correction) -> np.ndarray:
        """(3,) gravity, m/s^2, that explains the torques best beside friction and offsets."""
        m = self.moved(correction)
        y, *_ = self.read(correction)
        rest = self.described(m, Description((0.0, 0.0, 0.0)))
        X = self._per_gravity(m)
        gap = y - rest
        weight = 1.0 / np.maximum(np.mean(y**2, axis=1), 1e-12)
        G, slope = np.zeros((3, 3)), np.zeros(3)
        for k, j in enumerate(self.of_joint):
            nuisance = np.column_stack([np.ones(len(m.time)), m.v[:, j], m.direction[:, j]])
            still = 0.05 * self._effort[j] * np.array([1.0, 2.0, 2.0])
            A = np.column_stack([X[k], nuisance * still])
            damped = A.T @ A + np.diag([0.0] * 3 + [0.05 / weight[k]] * 3) + 1e-12 * np.eye(6)
            own = damped[:3, :3] - damped[:3, 3:] @ np.linalg.solve(damped[3:, 3:], damped[3:, :3])
            right = A.T @ gap[k]
            G += weight[k] * own
            slope += weight[k] * (right[:3] - damped[:3, 3:] @ np.linalg.solve(damped[3:, 3:], right[3:]))
        values, vectors = np.linalg.eigh(G)
        kept = values > 1e-6 * values[-1]
        found = vectors[:, kept] @ ((vectors.T @ slope)[kept] / values[kept])
        return np.asarray(found)

    def _per_gravity(self, m: Motion) -> np.ndarray:
        """(J, n, 3) torque per gravity."""
        return MotionSamples(self.model.arm.model, m, m.time).described_per_gravity[self.of_joint]

    @cached_property
    def _effort(self) -> np.ndarray:
        """(nj,) N m or N: what the joints are made for, or, where nobody wrote it, what they hold."""
        limits = np.array(self.model.arm.model.effortLimit)
        held = np.abs(inverse_dynamics(self.model.arm.model, *(self.motion.q, self.motion.v, self.motion.a))).max(
            axis=0
        )
        return np.where(limits < 1e4, limits, 2.0 * held + 1e-6)

    @cached_property
    def _own(self) -> ArmModel:
        """The model with those of its effects by which a torque depends on this moment alone."""
        return self.model.with_only([e.name for e in self.model.effects if not depends_on_before(e)])

    @cached_property
    def _extended(self) -> tuple[ArmModel, np.ndarray, np.ndarray]:
        """The model with every effect at its null value; (p,) typical sizes; (p,) bool, not negative."""
        model = self._own.with_candidates([e for e in self.effects if not (e.name in ASIDE or depends_on_before(e))])
        size = [p.typical * LARGE.get(p.effect or "", 1.0) for p in model.parameters.values()]
        absent = [name not in self._own.parameters for name in model.names]
        positive = [
            new and p.lower == 0.0 and p.null == 0.0 for new, p in zip(absent, model.parameters.values(), strict=True)
        ]
        return model, np.array(size), np.array(positive, dtype=bool)

    @cached_property
    def _linear_as_described(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._linear(MotionSamples(self.model.arm.model, self.motion, self.motion.time), 1.0)

    def _linear(self, stretch: MotionSamples, heavier: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(J, n) torques, (J, n, p) columns over their typical sizes, and which sizes cannot be negative."""
        model, size, positive = self._extended
        m = stretch.motion
        torques, derivatives = model.at_states(stretch)
        described = torques.T[self.of_joint]
        # A link deforms by shares of its mass and extent, which the description may have wrong.
        size = np.where([p.effect == "link_inertia" for p in model.parameters.values()], heavier * size, size)
        own = (derivatives * size).transpose(1, 0, 2)[self.of_joint]
        load = max(1.0, LOAD * heavier * float(self.model.arm.described[:, 0].sum()))
        carried = np.array([1.0, LEVER, LEVER, LEVER, *([LEVER**2] * 6)]) * load
        payload = (stretch.regressor[:, :, -1] * carried).transpose(1, 0, 2)[self.of_joint]
        tilt = self._per_gravity(m) * (TILT * float(np.linalg.norm(self.model.gravity())))
        late = LATE * np.gradient(described, m.time, axis=1)
        apart = np.einsum("jn,jk->jnk", late, np.eye(len(described)))
        columns = np.concatenate([own, payload, tilt, apart], axis=2)
        of_payload = np.arange(payload.shape[2]) == 0
        none = np.zeros(tilt.shape[2] + apart.shape[2], dtype=bool)
        return described, columns, np.concatenate([positive, of_payload, none])
