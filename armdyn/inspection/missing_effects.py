"""All effects that an arm's model may lack, as columns of a linear model with typical sizes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.composition import depends_on_past
from armdyn.arm.model import ArmModel
from armdyn.arm.slots import FADING_FRICTION, GRAVITY, LINK, READING_DELAY, TORQUE, simplest_effect, slots_of
from armdyn.effects.effect import Effect
from armdyn.inspection.evidence import EffectSizes

SEPARATE_SLOTS, SEPARATE_REACHES = frozenset({READING_DELAY, GRAVITY, TORQUE, FADING_FRICTION}), ("last", "coupled")
"""Slots and reaches of effects whose columns the inspection of an arm computes itself in another form (a delay, a tilt,
a payload), or that are close to other effects."""
USUAL_TORQUE_DELAY_SECONDS, MAX_TORQUE_DELAY_SECONDS = 0.03, 0.1
"""Usual delay of recorded torques, and the shift of a clock, s, from which on it is a mistake."""
USUAL_BASE_TILT_RADIANS, MIN_MOUNTING_ANGLE = 0.1, np.deg2rad(12.0)
"""Usual tilt of an arm's base, rad, and least angle between gravity and its description for an arm on a wall or
ceiling; a smaller angle is an effect, a tilted base."""
USUAL_PAYLOAD_SHARE_OF_ARM_MASS, USUAL_PAYLOAD_DISTANCE_METRES = 0.15, 0.2
"""Mass of a typical payload, as a share of the arm's mass, and its distance from the hand, m."""
INERTIAL_POWERS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""Power of length in the unit of each inertial parameter of a body: mass, first moments, second moments."""


def _is_separate(effect: Effect) -> bool:
    return bool(slots_of(effect).names & SEPARATE_SLOTS) or effect.reach in SEPARATE_REACHES


@dataclass(frozen=True, eq=False)
class MissingEffects:
    """The effects that an arm's model may lack.

    Attributes:
        model: the model with its effects.
        effects: further effects that the model may lack.
    """

    model: ArmModel
    effects: tuple[Effect, ...]

    @cached_property
    def own(self) -> ArmModel:
        """The model with those of its effects whose torque depends only on the present moment."""
        return self.model.with_only_effects([e.name for e in self.model.effects if not depends_on_past(e)])

    @cached_property
    def _extended(self) -> tuple[ArmModel, np.ndarray, EffectSizes]:
        """The model with all effects at null; (p,) typical sizes; prior knowledge on the sizes, also of `_linear`'s."""
        model = self.own.with_fixed_null_effects(
            [e for e in self.effects if not (_is_separate(e) or depends_on_past(e))]
        )
        parameters = list(model.parameters.values())
        size = np.array([p.typical for p in parameters])
        value = np.array([p.value for p in parameters])
        # A link that loses all of its mass weighs nothing.
        links = simplest_effect(LINK).name
        lower = np.array([max(p.lower, -1.0) if p.effect == links else p.lower for p in parameters])
        upper = np.array([p.upper for p in parameters])
        effects = [*dict.fromkeys(p.effect for p in parameters), "a load", "a tilt", "delays"]
        nj, none = len(self.model.arm.joints), np.full(len(INERTIAL_POWERS) - 1, np.inf)
        tilt = np.sin(MIN_MOUNTING_ANGLE) / USUAL_BASE_TILT_RADIANS
        late = MAX_TORQUE_DELAY_SECONDS / USUAL_TORQUE_DELAY_SECONDS
        beside = np.concatenate([[1.0 / USUAL_PAYLOAD_SHARE_OF_ARM_MASS], none, np.full(3, tilt), np.full(nj, late)])
        of_beside = np.repeat(len(effects) + np.array([-3, -2, -1]), [len(INERTIAL_POWERS), 3, nj])
        sizes = EffectSizes(
            np.concatenate([[effects.index(p.effect) for p in parameters], of_beside]).astype(int),
            np.concatenate([(lower - value) / size, [0.0], -beside[1:]]),
            np.concatenate([(upper - value) / size, beside]),
        )
        return model, size, sizes

    @property
    def sizes(self) -> EffectSizes:
        """Prior knowledge on the (p,) sizes of all effects, in their typical sizes."""
        return self._extended[2]

    def columns_of_effect(self, effect: str) -> np.ndarray:
        """(p,) bool, the unknowns of the evidence that belong to an effect."""
        model, _, sizes = self._extended
        own = [p.effect == effect for p in model.parameters.values()]
        return np.pad(np.array(own, dtype=bool), (0, len(sizes.kind) - len(own)))

    def linear(self, stretch: MotionSamples, heavier: float) -> tuple[np.ndarray, np.ndarray]:
        """(nj, n) torques with all effects at null, and (nj, n, p) columns times typical sizes.

        Args:
            stretch: the motion, and the arm as described or with a correction of its description.
            heavier: factor on first moments of links by that correction.
        """
        model, size, _ = self._extended
        m = stretch.motion
        torques, derivatives = model.at_states(stretch)
        described = torques.T
        # A link changes by shares of its mass and extent, which the description may have wrong.
        links = simplest_effect(LINK).name
        size = np.where([p.effect == links for p in model.parameters.values()], heavier * size, size)
        own = (derivatives * size).transpose(1, 0, 2)
        load = max(1.0, USUAL_PAYLOAD_SHARE_OF_ARM_MASS * heavier * float(self.model.arm.described[:, 0].sum()))
        carried = load * USUAL_PAYLOAD_DISTANCE_METRES**INERTIAL_POWERS
        joints = range(len(stretch.carried))
        last, none = joints[-1], np.zeros((len(m.time), len(carried)))
        of_last = [stretch.by_inertia[j][:, -1] if stretch.carries(j, last) else none for j in joints]
        payload = np.array(of_last) * carried
        per_gravity = MotionSamples(self.model.arm.model, m, m.time).per_gravity.described
        tilt = per_gravity * (USUAL_BASE_TILT_RADIANS * float(np.linalg.norm(self.model.gravity())))
        late = USUAL_TORQUE_DELAY_SECONDS * np.gradient(described, m.time, axis=1)
        delays = late[:, :, None] * np.eye(len(late))[:, None]
        return described, np.concatenate([own, payload, tilt, delays], axis=2)
