"""Servo drives, which follow a command: their error, times a gain, is the torque that they give.

Their laws are in `control_laws`; a drive with a torque command, or with a recorded current, states its torque itself.
What follows from a recorded command becomes `tau.<joint>` of a run, and is treated like a measured torque. While the
drive is on, its own damping and the back-EMF of its motor are not identifiable beside viscous friction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from typing import Any

import numpy as np

from armdyn.arm.control_laws import CONTROL_LAWS, ControlLaw
from armdyn.arm.known_drives import KNOWN_DRIVES
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.recording.units import KnownQuantity, parse_quantity, sliding_unit
from armdyn.run import Run
from urdf.toml_tables import table_to_dataclass

GAIN_SCALE_CHANNEL = "extra.gain_scale"
"""Recorded column: the gain that was set, over that of the model."""
MIN_GAIN, MAX_GAIN = 1e-6, 1e9
"""Smallest and largest possible gain of a drive, in its unit: with more, a thousandth of a radian gives more torque
than any arm has, and with less no error gives any."""


@dataclass(frozen=True)
class Servo:
    """Settings of servo drives of one kind; an unknown value is None.

    Attributes:
        joints: joints that they drive.
        law: quantity that they control.
        gain: torque per error of position or velocity, per commanded torque, or per current.
        damping: torque per velocity error of a position servo, N m s/rad or N s/m.
        supply: supply voltage at which gain and limit hold, V; both follow a recorded voltage.
        limit: largest torque, N m or N.
        full_at: error, in the unit of the command, at which the torque saturates; beside or in place of `limit`.
        delay: time from the command's stamp to the torque, s.
        rate: largest speed with which a position servo follows its command, rad/s or m/s.
        reference: mean voltage of the recordings that gave the gain, V, where the gain does not follow the supply; see
            the effect `supply_voltage`.
        unloaded: standard deviation of the gain without an unknown load; None means that of the gain.
        determined: whether the gain is identifiable; otherwise values of its joints are ratios to it.
    """

    joints: tuple[str, ...]
    law: str = "position"
    gain: KnownQuantity | None = None
    damping: float = 0.0
    supply: float | None = None
    limit: float = np.inf
    full_at: float = np.inf
    delay: float | None = None
    rate: float = np.inf
    reference: float | None = None
    unloaded: float | None = None
    determined: bool = True

    @property
    def largest(self) -> float:
        """Largest torque of the drive, N m or N."""
        return self.limit if self.gain is None else min(self.limit, self.gain.value * self.full_at)

    @property
    def saturating(self) -> float:
        """Error at which the torque saturates, with the usual gain."""
        return self.full_at if self.gain is None else min(self.full_at, self.limit / self.gain.value)

    @property
    def control(self) -> ControlLaw:
        """The control law."""
        return CONTROL_LAWS[self.law]

    @property
    def feedback(self) -> tuple[float, float]:
        """Torque per error of the position and of the velocity; 0 for a law that feeds neither back."""
        return self.control.feedback(0.0 if self.gain is None else self.gain.value, self.damping)

    def command(self, joint: str) -> str:
        """Name of the channel with the command of a joint."""
        return f"{self.control.channel}.{joint}"

    def torque_share(self, run: Run, joint: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) share of its torque that the drive of a joint gives at (n,) times, and (n,) share of its gain.

        The share of the torque is 0 while the drive is off.
        """
        share, scale = np.ones(len(time)), np.ones(len(time))
        if f"enabled.{joint}" in run.channels:
            share = (run.channels[f"enabled.{joint}"].zero_order_hold_values(time) > 0.5).astype(float)
        if self.supply is not None and f"voltage.{joint}" in run.channels:
            volts = run.channels[f"voltage.{joint}"]
            share = share * np.interp(time, volts.time, np.abs(volts.value)) / self.supply
        if GAIN_SCALE_CHANNEL in run.extra:
            scale = run.extra[GAIN_SCALE_CHANNEL].zero_order_hold_values(time)
        return share, scale

    def relative_excess_voltage(self, run: Run, joint: str, time: np.ndarray) -> np.ndarray:
        """(n,) relative excess of the recorded voltage over that of the gain, at (n,) times; 0 without a voltage."""
        volts, at = run.channels.get(f"voltage.{joint}"), self.supply or self.reference
        if volts is None or at is None:
            return np.zeros(len(time))
        return np.asarray(np.interp(time, volts.time, np.abs(volts.value)) / at - 1.0)

    def entries(self, slides: bool) -> dict[str, Any]:
        """Entries of the drive's table in a model file."""
        found: dict[str, Any] = {"joints": list(self.joints), "law": self.law}
        if self.gain is not None:
            spread = "" if self.gain.std is None else f" +/- {self.gain.std:.4g} {self.gain.unit}"
            found["gain"] = f"{self.gain.value:.6g} {self.gain.unit}{spread}"
        units = [(key, unit) for key, unit in _units(self.law, slides).items() if key != "gain"]
        changed = {key: unit for key, unit in units if getattr(self, key) != getattr(Servo, key)}
        return found | {key: f"{getattr(self, key):.6g} {unit}" for key, unit in changed.items()}


def gain_unit(law: str, slides: bool) -> str:
    """Unit of the gain of drives with this law, on joints that slide or turn."""
    unit = CONTROL_LAWS[law].gain_unit
    return sliding_unit(unit) if slides else unit


def _units(law: str, slides: bool) -> dict[str, str]:
    """Units of a drive's quantities, by their keys in a model file."""
    turning = {
        "gain": CONTROL_LAWS[law].gain_unit, "damping": "N m s/rad", "supply": "V", "limit": "N m",
        "full_at": CONTROL_LAWS[law].error_unit, "delay": "s", "rate": "rad/s", "reference": "V",
    }  # fmt: skip
    return {key: sliding_unit(unit) if slides else unit for key, unit in turning.items()}


_QUANTITIES = tuple(_units("position", slides=False))
_Entry: Any = make_dataclass(
    "_Entry", [("joints", tuple[str, ...]), ("law", str, "position"), *((key, str | None, None) for key in _QUANTITIES)]
)


def read_drives(table: Mapping[str, Any], slides: Mapping[str, bool]) -> dict[str, Servo]:
    """Read the tables ``[drives.NAME]`` of a model file.

    Args:
        table: the tables, by name of the kind of drive.
        slides: whether each joint of the arm slides.

    Raises:
        InputError: an entry cannot be used.
    """
    found, driven = dict[str, Servo](), dict[str, str]()
    if not isinstance(table, Mapping):
        raise InputError("[drives]: write a table for each kind of drive, such as [drives.sts3215]")
    for name, entries in table.items():
        with error_location(f"[drives.{name}]"):
            entry = table_to_dataclass(_Entry, entries)
            if entry.law not in CONTROL_LAWS:
                raise UnknownNameError("law", entry.law, CONTROL_LAWS)
            if not entry.joints:
                raise InputError("joints: name at least one")
            for joint in entry.joints:
                if joint not in slides:
                    raise UnknownNameError("joint of the arm", joint, slides)
                if joint in driven:
                    raise InputError(
                        f"joint '{joint}' is driven by [drives.{driven[joint]}] already: leave it out of one"
                    )
                driven[joint] = name
            kinds = {slides[joint] for joint in entry.joints}
            if len(kinds) > 1:
                raise InputError("joints: some turn and some slide: write a table for each kind")
            found[name] = _servo(entry, slides=kinds.pop())
    return found


def chosen_drives(chosen: Sequence[str], joints: Sequence[str]) -> dict[str, Any]:
    """Table ``[drives]`` of a model file for kinds of drives that are known, or of which only the law is known.

    Args:
        chosen: texts ``"KIND=all"``, ``"KIND=joint,joint"``, or ``"NAME:LAW=joint,joint"`` for a kind of which nothing
            else is known.
        joints: joints of the arm.

    Raises:
        InputError: a kind or a law is unknown, or a text has another form.
    """
    found: dict[str, Any] = {}
    for text in chosen:
        kind, colon, law, listed = split_drive_option(text)
        if colon and law not in CONTROL_LAWS:
            raise UnknownNameError("law", law, CONTROL_LAWS)
        if not colon and kind not in KNOWN_DRIVES:
            hint = f"; of another kind state the law, as in {kind}:position={listed}"
            raise UnknownNameError("drive", kind, KNOWN_DRIVES, hint)
        known = {"law": law} if colon else KNOWN_DRIVES[kind]
        found[kind] = {"joints": list(joints) if listed == "all" else listed.split(","), **known}
    return found


def split_drive_option(text: str) -> tuple[str, str, str, str]:
    """Kind, colon, law and joints of a text such as ``"KIND=all"``, ``"KIND=joint,joint"`` or ``"NAME:LAW=all"``.

    Colon and law are empty where no law is stated.

    Raises:
        InputError: the text has another form.
    """
    named, equals, listed = text.partition("=")
    kind, colon, law = named.partition(":")
    if not equals or not listed or not kind:
        raise InputError(f"--drive {text}: write it as sts3215=all, sts3215=elbow,wrist, or NAME:position=all")
    return kind, colon, law, listed


def law_of_commands(run: Run) -> str | None:
    """The law of drives whose commands a recording contains; None where it has a torque, or no command."""
    kinds = {name.partition(".")[0] for name in run.channels}
    return None if "tau" in kinds else next((name for name, law in CONTROL_LAWS.items() if law.channel in kinds), None)


def _servo(entry: Any, *, slides: bool) -> Servo:
    values: dict[str, Any] = {}
    for key, unit in _units(entry.law, slides).items():
        text = getattr(entry, key)
        if text is not None:
            with error_location(key):
                read = parse_quantity(text, unit)
                if read.value < 0.0 or (read.value == 0.0 and key not in ("damping", "delay")):
                    raise InputError(f"'{text}': write one that is positive")
                if key == "gain" and not MIN_GAIN <= read.value <= MAX_GAIN:
                    size = "small" if read.value < MIN_GAIN else "large"
                    raise InputError(f"'{text}' is too {size} for a drive: check its number and unit")
            values[key] = read if key == "gain" else read.value
    return Servo(entry.joints, entry.law, **values)
