"""Read the header of a column: its quantity, its unit, whether it was measured, and words that may name the joint."""

import re
from dataclasses import dataclass, replace
from itertools import chain

from armdyn.errors import InputError
from armdyn.recording.channels import JOINT_CHANNELS
from armdyn.recording.units import si_factor


def word_set(text: str) -> frozenset[str]:
    """Set of the words of a text, which are separated by blanks."""
    return frozenset(text.split())


QUANTITY_WORDS = {
    "a": "acceleration accelerations accel acc jacc qdd ddq qddot ddtheta",
    "v": "velocity velocities vel vels jvel speed speeds qd dq qdot dtheta thetadot omega rate v",
    "tau": "torque torques tau taus effort efforts trq tor moment moments jtau jtor jtorque mt drehmoment",
    "current": "current currents cur curr iq i strom amps",
    "force": "force forces kraft",
    "q": "position positions pos q qm qpos jpos mp angle angles ang theta th encoder enc winkel rad deg",
}
"""Words that name a quantity of a joint; in a header with several quantities the first one here is used."""
_QUANTITY_OF = {word: kind for kind, words in QUANTITY_WORDS.items() for word in words.split()}
DERIVATIVE_QUANTITIES = {("q", "dot"): "v", ("v", "dot"): "a", ("q", "ddot"): "a", ("q", "dd"): "a"}
COMMAND_WORDS = word_set(
    "target cmd command commanded desired des ref reference setpoint sp action goal soll sollwert plan planned "
    "nominal demand ipo leader master as"
)
OTHER_QUANTITY_WORDS = word_set(
    "temperature temperatures temp temps temperatur voltage voltages volt volts power pwm error errors err mode "
    "flag flags bits bit window min max limit limits stiffness damping kp kd ki gain gains covariance cov ext "
    "external contact wrench ft momentum tcp ee eef flange cartesian pose orientation quaternion quat euler rpy "
    "accelerometer imu inertia gravity coriolis friction bias residual feedforward ff predicted computed "
    "calculated image images digital analog io scaling fraction execution counter index id seq frame success "
    "brake fault warning ticks counts count percent pct duty load wear tool hat stamp secs nsecs disturbance cog "
    "energy energies kinetic potential kin pot"
)
"""Words of a header for other quantities than a joint's motion and torque, or for values computed from a model."""
CARTESIAN_WORDS = word_set("x y z rx ry rz qx qy qz qw roll pitch yaw")
"""Names of Cartesian coordinates in a header; a header with only such a name and a quantity belongs to no joint."""
WRENCH_WORDS = {"f": "f force forces", "t": "t m torque torques moment moments"}
WRENCH_AXIS_WORDS = {
    f"{word}{' ' * (len(word) > 1)}{letter}": f"{kind}{letter}"
    for kind, words in WRENCH_WORDS.items()
    for word in words.split()
    for letter in "xyz"
}
"""Axis of a wrench by the words that name it: ``fx``, ``mx`` and ``force x``."""
OF_A_WRENCH = word_set("wrench ft")
"""Words of a header with an axis of a wrench in N or N m, as ROS and UR define them."""
IRRELEVANT_WORDS = word_set(
    "actual measured meas measure msr ist act present joint joints jnt axis axes ax achse motor mot the data "
    "value val robot real feedback fbk fb state states observation of from filtered filt ai sensor field msg dof "
    "m est estimate estimated angular arm"
)
"""Words of a header that do not distinguish joints."""

_RATES = ("/s", "_s", " s", "ps", "_per_s", "_per_sec", "_per_second", "/sec", "_sec")
_SPELLINGS = {
    "N m": "Nm NM nm N_m N.m N*m N-m", "mN m": "mNm mnm", "N mm": "Nmm N_mm", "N cm": "Ncm N_cm", "kN m": "kNm",
    "foot * pound_force": "ftlb ft_lb ftlbf lbft", "mA": "mA ma mAmp", "A": "A amp Amp amps Amps ampere Ampere",
    "min": "minute minutes", "h": "hour hours",
    "ms": "ms msec msecs millis milliseconds", "us": "us usec usecs micros microseconds",
    "ns": "ns nsec nsecs nanos nanosec nanoseconds nanosecond", "s": "s sec secs seconds", "N": "N", "mN": "mN",
    "rpm": "rpm RPM", "mm": "mm", "cm": "cm", "m": "m", "rad": "rad radian radians Rad RAD", "mrad": "mrad",
    "deg": "deg degree degrees Deg DEG °", "turn": "rev revs revolution revolutions turns",
}  # fmt: skip
_UNIT_OF = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}
for _length in ("rad", "deg", "mm", "m", "degrees", "radians"):
    for _rate in _RATES:
        _unit = f"{_UNIT_OF[_length]}/s"
        _UNIT_OF[_length + _rate] = _unit
        _UNIT_OF |= {f"{_length}{_rate}{power}": f"{_unit}^2" for power in ("2", "^2", "²")}
_SUFFIX = re.compile(
    r"(?:^|(?<=[^A-Za-z]))(?P<unit>" + "|".join(sorted(map(re.escape, _UNIT_OF), key=len, reverse=True)) + r")"
    r"(?P<index>[ _.\[(]*\d+[\])]?)?$"
)
_GERMAN = re.compile(r"(ist|soll)(?=position|winkel|moment|strom|drehmoment)", re.IGNORECASE)
_GREEK = str.maketrans({"θ": "theta", "φ": "phi", "ϕ": "phi", "ω": "omega", "α": "alpha", "τ": "tau"})
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
QUANTITY_UNITS = {quantity: JOINT_CHANNELS[quantity].units for quantity in ("q", "v", "a", "tau", "current")}
QUANTITY_UNITS |= {"force": ("N",), "time": ("s",)}
"""SI units of each quantity."""


@dataclass(frozen=True)
class ColumnHeaderParts:
    """Parts of a column's header.

    Attributes:
        words: all words without the unit, in small letters, with numbers as separate words.
        quantity: a key of `QUANTITY_WORDS`; empty where no word names one.
        unit: unit in the header, in pint's notation; empty where there is none.
        measured: False for commands, for values computed from a model, and for other things than joints.
        rest: words and numbers that may name the joint.
        doubt: reason why a person must check the quantity; empty where it is certain.
        commanded: whether it is a command of a joint.
    """

    words: tuple[str, ...]
    quantity: str
    unit: str
    measured: bool
    rest: tuple[str, ...]
    doubt: str = ""
    commanded: bool = False


def name_words(text: str) -> tuple[str, ...]:
    """Words and numbers of a name, in small letters: actual, qd and 3 for ``actualQd_3``."""
    text = _GERMAN.sub(r"\1 ", text.translate(_GREEK))
    return tuple(str(int(word)) if word.isdigit() else word.lower() for word in _WORD.findall(text))


def split_column_header(name: str, unit: str = "") -> ColumnHeaderParts:
    """Parse a column's header.

    Args:
        name: header without a unit in brackets.
        unit: text in the brackets; empty for none.
    """
    # No robot is measured in megametres: [MM] is mm, however pint reads it.
    written = (
        _UNIT_OF.get(unit)
        or _UNIT_OF.get(unit.lower())
        or (unit if is_unit_like(unit, *chain(*QUANTITY_UNITS.values())) else "")
    )
    text = name.strip()
    if unit and not written and is_unit_like(unit, "J"):
        return ColumnHeaderParts(name_words(text), "", unit, False, ())
    if unit and not written:  # the brackets contain something else, such as the axis
        text = f"{text} {unit}"
    found = None if written else _SUFFIX.search(text)
    if found is not None:
        label = _without_unit(text[: found.start("unit")] + (found["index"] or ""), _UNIT_OF[found["unit"]])
        # A single letter is a unit only of the right quantity: the A of joint_A is not a unit.
        suits = label.quantity and is_unit_like(label.unit, *QUANTITY_UNITS[label.quantity])
        if suits or len(found["unit"]) > 1:
            return _completed(label)
    return _completed(_without_unit(text, written))


def is_unit_like(unit: str, *choices: str) -> bool:
    """Whether a text is a unit of the same kind as one of these SI units."""
    for si in choices:
        try:
            si_factor(unit, si)
        except InputError:
            continue
        return True
    return False


def _without_unit(text: str, unit: str) -> ColumnHeaderParts:
    words = name_words(text)
    kinds = [_QUANTITY_OF[word] for word in words if word in _QUANTITY_OF]
    quantity = next((kind for kind in QUANTITY_WORDS if kind in kinds), "")
    quantity = next(
        (made for (of, mark), made in DERIVATIVE_QUANTITIES.items() if of == quantity and mark in words), quantity
    )
    doubt, command_words = "", COMMAND_WORDS & set(words)
    if {"tau", "current"} <= set(kinds):
        command_words -= {"as"}
        quantity, doubt = ("current" if unit and is_unit_like(unit, "A") else "tau"), "a torque made of a current?"
    elif "motor" in words and "joint" not in words and quantity in ("q", "v", "tau"):
        doubt = "is this the motor's value or the joint's? Write gear_ratio for the motor's"
    elif quantity == "tau" and {"est", "estimate", "estimated"} & set(words):
        doubt = "an estimate"
    elif {"mp", "mt", "qm"} & set(words):
        doubt = "an abbreviation"
    noise = {*_QUANTITY_OF, *IRRELEVANT_WORDS, *COMMAND_WORDS, "dot", "ddot", "dd"}
    rest = tuple(word for word in words if word not in noise)
    letters = [word for word in rest if not word.isdigit()]
    coordinates = bool(letters) and set(letters) <= CARTESIAN_WORDS and len(letters) == len(rest)
    coordinates |= quantity in ("force", "tau") and bool({"x", "y", "z"} & set(letters))
    of_joint = not (OTHER_QUANTITY_WORDS & set(words) or coordinates)
    commanded = bool(command_words)
    return ColumnHeaderParts(words, quantity, unit, of_joint and not commanded, rest, doubt, of_joint and commanded)


def _completed(label: ColumnHeaderParts) -> ColumnHeaderParts:
    """The label with the quantity that its unit implies; a speed in the unit of an angle gets that unit per second."""
    quantity, unit = label.quantity, label.unit
    if not unit:
        return label
    if not quantity or (quantity == "q" and not is_unit_like(unit, *QUANTITY_UNITS["q"])):
        implied = next(
            (kind for kind in ("q", "v", "a", "force", "tau", "current") if is_unit_like(unit, *QUANTITY_UNITS[kind])),
            "",
        )
        if quantity and not implied:
            return replace(label, measured=False)
        return replace(label, quantity=implied)
    for per, kind in (("/s", "v"), ("/s^2", "a")):
        if (
            quantity == kind
            and not is_unit_like(unit, *QUANTITY_UNITS[kind])
            and is_unit_like(unit, *QUANTITY_UNITS["q"])
        ):
            return replace(label, unit=f"{unit}{per}")
    if quantity == "tau" and is_unit_like(unit, "A"):
        return replace(label, quantity="current")
    return label if is_unit_like(unit, *QUANTITY_UNITS[quantity]) else replace(label, measured=False)
