"""Which parameters of a simulator's joint an effect changes, read from its equation: no list of effects is kept.

A slot is a parameter that simulators know: a torque's factor of the velocity is a joint's damping, whatever the effect
is called that adds it. An effect whose equation is not a sum of slots has none, and says why.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from armdyn.arm.composition import composed_joint
from armdyn.arm.physics import DriveCommands, Expression
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect

GRAVITY, LINK = "gravity", "link"
"""Slots without a value of their own: the base's gravity, and a link's mass and inertia."""
DAMPING, FRICTION, ARMATURE, TORQUE = "damping", "friction", "armature", "torque"
"""Torque per velocity, with the sign of the velocity, per acceleration, and without any."""
STIFFNESS, REST_TORQUE, SINE, COSINE = "stiffness", "rest torque", "sine", "cosine"
"""Torque per position, that at position zero, and its parts in proportion to the position's sine and cosine."""
FADING_FRICTION, FADING_SPEED = "fading friction", "fading speed"
"""Dry friction at standstill, and the speed at which 1/e of it remains."""
PLAY = "play"
"""Way of a link to either side of its drive."""
GAIN, OFFSET, COMMAND_DELAY, READING_DELAY = "gain", "offset", "command delay", "reading delay"
"""Gain and offset of a torque's command or reading, and by how much one acts, or the other is read, too late."""
DRIVE_DAMPING, VELOCITY_COMMAND = "drive damping", "velocity command"
"""A drive's torque per velocity and per commanded velocity."""
PAST_COMMANDS, VOLTAGE = "what was before", "the supply voltage"
"""What a drive's torque may depend on that no slot holds."""
WRENCH_READING = "what a force/torque sensor reads"
"""What no joint has."""
PLAY_PARAMETER = "backlash.play"
"""Parameter of a joint: its link's way to either side of the drive's position, rad or m."""
CHECKED_POINTS, TOLERANCE, MAX_DEPTH = 5, 1e-9, 9
"""Number of points at which an expression is evaluated to know whether it is zero, up to a tolerance, and depth to
which two are compared."""


@dataclass(frozen=True)
class EffectSlots:
    """Slots of one effect.

    Attributes:
        names: the slots; empty if its equation is not a sum of slots.
        depends_on: what it depends on that no slot holds, or how; empty if it has slots.
    """

    names: frozenset[str]
    depends_on: str = ""
    _values: ca.Function | None = None
    _valued: tuple[str, ...] = ()

    @property
    def delays(self) -> bool:
        """Whether it delays what a drive is told, or what is read of it."""
        return bool(self.names & {COMMAND_DELAY, READING_DELAY})

    @property
    def needs_more_than_motion(self) -> bool:
        """Whether the torque at an instant depends on more than the motion: on what was before, or on the supply."""
        return self.delays or self.depends_on in (PAST_COMMANDS, VOLTAGE)

    @property
    def scales_reading(self) -> bool:
        """Whether it changes only gain and offset between a drive's torque and its command or reading."""
        return bool(self.names) and self.names <= {GAIN, OFFSET}

    def at(self, values: Sequence[float]) -> dict[str, float]:
        """Value of each slot, without gravity and links, at the values of the effect's quantities, in their order."""
        found = [] if self._values is None else self._values.call([ca.DM(value) for value in values])
        return dict(zip(self._valued, map(float, found), strict=True))


@cache
def slots_of(effect: Effect) -> EffectSlots:
    """The slots of an effect on an arm, or why it has none."""
    if effect.acts_on not in ("joint", "drive"):
        return EffectSlots(frozenset(), WRENCH_READING if effect.acts_on == "wrench" else "another stage")
    if effect.reach == "base":
        return EffectSlots(frozenset({GRAVITY}))
    if [f"{effect.name}.{short}" for short in effect.quantities] == [PLAY_PARAMETER]:  # no torque changes
        play = ca.SX.sym("play")
        return EffectSlots(frozenset({PLAY}), "", ca.Function("slots", [play], [play]), (PLAY,))
    if effect.columns:
        return EffectSlots(frozenset(), "a recorded column")
    composed = composed_joint((effect.on(),))
    before, after, theta = composed.before, composed.after, ca.vertsplit(composed.theta)
    q, v, a, way = before.position, before.velocity, before.acceleration, before.direction
    inner, told = before.inner, before.told
    found = dict[str, Expression]()
    if not ca.is_equal(after.link.pseudo_inertia, before.link.pseudo_inertia, MAX_DEPTH):
        found[LINK] = ca.SX(0)
    if not _vanishes(after.gain - 1):
        found[GAIN] = after.gain
    if not _vanishes(after.delay):
        found[READING_DELAY] = after.delay
    torque, reading = (ca.substitute(ca.SX(part), before.on, 1) for part in (after.torque, after.offset))
    if after.added_states or not _vanishes(after.inner_torque):
        return EffectSlots(frozenset(), "a state of its own" if after.added_states else "another joint")
    others = {
        "the time": [before.time], "the load": [before.load], PAST_COMMANDS: [told.total], VOLTAGE: [told.voltage],
        "the drive's torque": [told.torque],
        "another joint's motion": [inner.position, inner.velocity, inner.acceleration],
    }  # fmt: skip
    for what, symbols in others.items():
        if any(ca.depends_on(ca.vertcat(torque, reading), x) for x in symbols):
            return EffectSlots(frozenset(), what)
    motion = (q, v, a, way)
    try:
        found |= _torque_slots(torque, motion)
        found |= _reading_slots(reading, motion, told)
    except _NotLinearError as wrong_in:
        return EffectSlots(frozenset(), str(wrong_in))
    values = {name: part for name, part in found.items() if name != LINK}
    return EffectSlots(frozenset(found), "", ca.Function("slots", theta, [*values.values()]), tuple(values))


def simplest_effect(*slots: str) -> Effect:
    """The first effect of the catalogue that fills exactly these slots, on any joint."""
    return next(one for one in CATALOGUE.values() if slots_of(one).names == {*slots} and one.reach != "last")


class _NotLinearError(Exception):
    """An expression is not a sum of slots; the text says in what it is not linear."""


def _torque_slots(torque: Expression, motion: tuple[Expression, ...]) -> dict[str, Expression]:
    """Slots of a torque that depends on position, velocity, acceleration and the velocity's sign."""
    q, v, a, way = motion
    found = dict[str, Expression]()
    dry = ca.simplify(ca.jacobian(torque, way))
    fading, speed = _fading(dry, v)
    if fading is not None:
        found |= {FADING_FRICTION: fading, FADING_SPEED: speed}
        torque = ca.substitute(torque, way, 0)
    rest = torque
    for name, x in ((DAMPING, v), (ARMATURE, a), (FRICTION, way)):
        rest = _without(rest, name, x, motion, found)
    stiffness = ca.jacobian(rest, q)
    if _vanishes(stiffness):
        if not _vanishes(rest):
            found[TORQUE] = rest
    elif _vanishes(ca.jacobian(stiffness, q)):
        found |= {STIFFNESS: stiffness, REST_TORQUE: ca.substitute(rest, q, 0)}
    else:
        sine, cosine = (ca.substitute(rest, q, angle) for angle in (np.pi / 2, 0.0))
        if not _vanishes(rest - sine * ca.sin(q) - cosine * ca.cos(q)):
            raise _NotLinearError("another function of the position")
        found |= {SINE: sine, COSINE: cosine}
    return found


def _reading_slots(reading: Expression, motion: tuple[Expression, ...], told: DriveCommands) -> dict[str, Expression]:
    """Slots of a drive's reading, or of its torque by its law with the other sign, without load."""
    found, known = dict[str, Expression](), (*motion, told.rate, told.velocity)
    for name, x in ((DRIVE_DAMPING, motion[1]), (COMMAND_DELAY, told.rate), (VELOCITY_COMMAND, told.velocity)):
        reading = _without(reading, name, x, known, found)
    if any(ca.depends_on(reading, x) for x in known if not _vanishes(ca.jacobian(reading, x))):
        raise _NotLinearError("the motion, in the drive's reading")
    if not _vanishes(reading):
        found[OFFSET] = reading
    return found


def _without(
    whole: Expression, name: str, x: Expression, motion: Sequence[Expression], found: dict[str, Expression]
) -> Expression:
    """An expression without its part in proportion to `x`, whose factor is a slot that is added to those found."""
    factor = ca.simplify(ca.jacobian(whole, x))
    if _vanishes(factor):
        return whole
    if any(not _vanishes(ca.jacobian(factor, y)) for y in motion):
        raise _NotLinearError(f"no constant {name}")
    found[name] = factor
    return ca.substitute(whole, x, 0)


def _fading(dry: Expression, v: Expression) -> tuple[Expression | None, Expression]:
    """Friction f and speed v_s with which a factor of the velocity's sign is f exp(-(v / v_s)^2); None for another."""
    first, second = ca.jacobian(dry, v), ca.jacobian(ca.jacobian(dry, v), v)
    if _vanishes(first):
        return None, ca.SX(0)
    still = ca.substitute(dry, v, 0)
    speed = ca.sqrt(-2 * still / ca.substitute(second, v, 0))
    fades = _vanishes(dry - still * ca.exp(-((v / speed) ** 2)))
    return (still, speed) if fades else (None, ca.SX(0))


def _vanishes(part: Expression) -> bool:
    """Whether an expression is zero at points drawn at random."""
    symbols, random = ca.symvar(ca.SX(part)), np.random.default_rng(0)
    function = ca.Function("part", symbols, [ca.densify(ca.SX(part))])
    drawn = (random.uniform(0.1, 1.0, len(symbols)).tolist() for _ in range(CHECKED_POINTS))
    return all(
        np.abs(np.array(function.call([ca.DM(x) for x in one])[0])).max(initial=0.0) < TOLERANCE for one in drawn
    )
