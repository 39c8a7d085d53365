"""Drives that do what they are told: a servo is a torque sensor whose gain may be unknown.

A position servo gives k (q_cmd - q), so that its own error says which torque it gave; a velocity servo likewise by its
velocity's error, and a drive that is told a torque or records its current says it itself. Such a reading stands in a
run as `tau.<joint>`, and everything that holds for measured torques holds for it. What the drive adds in proportion to
the velocity, its own damping and the back-EMF of its motor, cannot be told from viscous friction while it is on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from armdyn.errors import InputError, UnknownNameError, at
from armdyn.recording.units import Known, parse_quantity
from armdyn.run import Run
from urdf.table_file import read_as

Law = Literal["position", "velocity", "torque", "current"]
UNITS: Mapping[Law, tuple[str, str]] = {
    "position": ("N m/rad", "N/m"),
    "velocity": ("N m s/rad", "N s/m"),
    "torque": ("1", "1"),
    "current": ("N m/A", "N/A"),
}
"""Of the gain, where the joint turns and where it slides."""
TOLD: Mapping[Law, str] = {"position": "q_cmd", "velocity": "v_cmd", "torque": "tau_ff", "current": "current"}
"""Channel that a drive of each law obeys, or records."""
SCALE = "extra.gain_scale"
"""Further column: the gain that was set over the model's, where it was changed."""

KNOWN: Mapping[str, Mapping[str, str]] = {
    # At 7.4 V and register P = 32: k_p 17.8 N m/rad, 3.35 N m (Open Duck Mini's MJCF; P and V as in Rhoban's BAM, whose
    # values it has). LeRobot sets P = 16. At 12 V both are larger: the recording says by how much.
    "sts3215": {"law": "position", "gain": "8.9 N m/rad +/- 10 %", "limit": "3.35 N m"},
    # Full duty from an error of 885 x 256 x 2 pi/4096 / P rad at register P; here P = 100: BAM (Rhoban).
    "xl330": {"law": "position", "full_at": "3.47 rad"},
}
"""Kinds of drives: gain and limit as they are usually set, ``extra.gain_scale`` beside a recording says otherwise."""


@dataclass(frozen=True)
class Servo:
    """Drives of one kind; what is not known is None.

    Attributes:
        joints: that they drive.
        law: what they are told.
        gain: torque per error of the position or velocity, per torque that was asked for, or per current.
        damping: of a position servo, N m s/rad or N s/m: torque per error of the velocity.
        supply: V at which gain and limit hold; both follow a recorded voltage.
        limit: N m or N.
        full_at: error, of the gain's unit, from which it gives all that it has; beside or in place of `limit`.
        delay: s from the command's stamp to the torque.
        rate: rad/s or m/s at which a position servo follows what it is told at most.
        reference: V of the recordings that told the gain, where that does not follow the supply; see `supply_voltage`.
        unloaded: standard deviation of the gain if nothing is carried that the model lacks; the gain's own where None.
        determined: whether something says how large the gain is; values of its joints are ratios to it where not.
    """

    joints: tuple[str, ...]
    law: Law = "position"
    gain: Known | None = None
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
        """Torque that it gives at most, N m or N."""
        return self.limit if self.gain is None else min(self.limit, self.gain.value * self.full_at)

    @property
    def saturating(self) -> float:
        """Error from which it is saturated at its usual gain."""
        return self.full_at if self.gain is None else min(self.full_at, self.limit / self.gain.value)

    def gate(self, run: Run, joint: str, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) share of its torque that it gives at (n,) times, 0 where it is off, and (n,) share of its gain."""
        share, scale = np.ones(len(time)), np.ones(len(time))
        if f"enabled.{joint}" in run.channels:
            share = (run.channels[f"enabled.{joint}"].held(time) > 0.5).astype(float)
        if self.supply is not None and f"voltage.{joint}" in run.channels:
            volts = run.channels[f"voltage.{joint}"]
            share = share * np.interp(time, volts.time, np.abs(volts.value)) / self.supply
        if SCALE in run.extra:
            scale = run.extra[SCALE].held(time)
        return share, scale

    def over_reference(self, run: Run, joint: str, time: np.ndarray) -> np.ndarray:
        """(n,) recorded voltage at (n,) times over the one at which the gain holds, less one; 0 where none is."""
        volts, at = run.channels.get(f"voltage.{joint}"), self.supply or self.reference
        if volts is None or at is None:
            return np.zeros(len(time))
        return np.asarray(np.interp(time, volts.time, np.abs(volts.value)) / at - 1.0)

    def error_unit(self, slides: bool) -> str:
        """Of what it is told."""
        turning = {"position": "rad", "velocity": "rad/s", "torque": "N m", "current": "A"}[self.law]
        return turning.replace("rad", "m").replace("N m", "N") if slides else turning

    def entries(self, slides: bool) -> dict[str, Any]:
        """The table of a model file."""
        turning, sliding = ("N", "m") if slides else ("N m", "rad")
        found: dict[str, Any] = {"joints": list(self.joints), "law": self.law}
        if self.gain is not None:
            spread = "" if self.gain.std is None else f" +/- {self.gain.std:.4g} {self.gain.unit}"
            found["gain"] = f"{self.gain.value:.6g} {self.gain.unit}{spread}"
        values = {
            "damping": (self.damping, f"{turning} s/{sliding}", 0.0),
            "supply": (self.supply, "V", None),
            "limit": (self.limit, turning, np.inf),
            "full_at": (self.full_at, self.error_unit(slides), np.inf),
            "delay": (self.delay, "s", None),
            "rate": (self.rate, f"{sliding}/s", np.inf),
            "reference": (self.reference, "V", None),
        }
        return found | {key: f"{value:.6g} {unit}" for key, (value, unit, none) in values.items() if value != none}


@dataclass(frozen=True)
class _Entry:
    joints: tuple[str, ...]
    law: str = "position"
    gain: str | None = None
    damping: str | None = None
    supply: str | None = None
    limit: str | None = None
    full_at: str | None = None
    delay: str | None = None
    rate: str | None = None
    reference: str | None = None


def read_drives(table: Mapping[str, Any], slides: Mapping[str, bool]) -> dict[str, Servo]:
    """``[drives.NAME]`` of a model file.

    Args:
        table: by name of the kind of drive.
        slides: by joint of the arm, whether it slides.

    Raises:
        InputError: names the table, the entry, what is wrong and what to do.
    """
    found: dict[str, Servo] = {}
    driven: dict[str, str] = {}
    if not isinstance(table, Mapping):
        raise InputError("[drives]: write a table for each kind of drive, such as [drives.sts3215]")
    for name, entries in table.items():
        with at(f"[drives.{name}]"):
            entry = read_as(_Entry, entries)
            if entry.law not in get_args(Law):
                raise UnknownNameError("law", entry.law, get_args(Law))
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
                raise InputError("joints that turn and joints that slide: write a table for each")
            found[name] = _servo(entry, slides=kinds.pop())
    return found


def known_drives(chosen: Sequence[str], joints: Sequence[str]) -> dict[str, Any]:
    """``[drives]`` of a model file for kinds of drives that are known.

    Args:
        chosen: ``"KIND=all"`` or ``"KIND=joint,joint"`` each.
        joints: of the arm.

    Raises:
        InputError: a kind is unknown, or it is written otherwise.
    """
    found: dict[str, Any] = {}
    for text in chosen:
        kind, equals, listed = text.partition("=")
        if not equals or not listed:
            raise InputError(f"--drive {text}: write it as --drive sts3215=all, or with joints, sts3215=elbow,wrist")
        if kind not in KNOWN:
            raise UnknownNameError("drive", kind, KNOWN, "; write others into the model file, [drives.NAME]")
        found[kind] = {"joints": list(joints) if listed == "all" else listed.split(","), **KNOWN[kind]}
    return found


def _servo(entry: _Entry, *, slides: bool) -> Servo:
    law: Any = entry.law
    torque, way = ("N", "m") if slides else ("N m", "rad")
    told = Servo(entry.joints, law).error_unit(slides)
    units = {"full_at": told, "damping": f"{torque} s/{way}", "supply": "V", "limit": torque, "delay": "s"}
    units |= {"rate": f"{way}/s", "reference": "V"}
    values: dict[str, Any] = {}
    for key, unit in units.items():
        text = getattr(entry, key)
        if text is not None:
            with at(key):
                values[key] = parse_quantity(text, unit).value
                if values[key] < 0.0 or (values[key] == 0.0 and key not in ("damping", "delay")):
                    raise InputError(f"'{text}': write one that is positive")
    gain = None
    if entry.gain is not None:
        with at("gain"):
            gain = parse_quantity(entry.gain, UNITS[law][slides])
            if gain.value <= 0.0:
                raise InputError(f"'{entry.gain}': write one that is positive")
    return Servo(entry.joints, law, gain, **values)
