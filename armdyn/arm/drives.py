"""Drives that do what they are told: a servo is a torque sensor whose gain may be unknown.

A position servo gives k (q_cmd - q), so that its own error says which torque it gave; a velocity servo likewise by its
velocity's error, and a drive that is told a torque or records its current says it itself. Such a reading stands in a
run as `tau.<joint>`, and everything that holds for measured torques holds for it. What the drive adds in proportion to
the velocity, its own damping and the back-EMF of its motor, cannot be told from viscous friction while it is on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from armdyn.arm.motion import measured_motion
from armdyn.channels import Channel, Reading
from armdyn.errors import InputError, UnknownNameError, at
from armdyn.kept import kept_alongside
from armdyn.run import Run
from armdyn.units import Known, parse_quantity
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

TIMED = 2e-4
"""s by which a delay is usually off that recordings say: the median of 40 generated arms."""
INFORMATIVE = (0.1, 0.9)
"""Quantiles of a reading that differ where it says anything: a joint that stands reads one value, but for a few."""

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
    values: dict[str, Any] = {}
    for key, unit in units.items():
        text = getattr(entry, key)
        if text is not None:
            with at(key):
                values[key] = parse_quantity(text, unit).value
                if values[key] < 0.0 or (values[key] == 0.0 and key in ("supply", "limit", "full_at")):
                    raise InputError(f"'{text}': write one that is positive")
    gain = None
    if entry.gain is not None:
        with at("gain"):
            gain = parse_quantity(entry.gain, UNITS[law][slides])
            if gain.value <= 0.0:
                raise InputError(f"'{entry.gain}': write one that is positive")
    return Servo(entry.joints, law, gain, **values)


def mean_held(channel: Channel, edges: np.ndarray) -> np.ndarray:
    """(n,) means between (n + 1,) rising times of what holds from its stamp to the next one, smooth in the times."""
    time, value = channel.time, channel.value
    area = np.concatenate([[0.0], np.cumsum(np.diff(time) * value[:-1])])
    inside = np.clip(edges, time[0], time[-1])
    whole = np.interp(inside, time, area) + np.where(edges < time[0], value[0] * (edges - time[0]), 0.0)
    whole = whole + np.where(edges > time[-1], value[-1] * (edges - time[-1]), 0.0)
    return np.asarray(np.diff(whole) / np.diff(edges))


def reads(run: Run, joint: str, servo: Servo) -> bool:
    """Whether a run holds what a drive's reading is made of, and no measured torque."""
    return f"tau.{joint}" not in run.channels and f"{TOLD[servo.law]}.{joint}" in run.channels


def error(
    run: Run, joints: tuple[str, ...], joint: str, servo: Servo, delay: float, time: np.ndarray, *, smooth: bool
) -> np.ndarray:
    """(n,) what a drive reads at (n,) times before its gain, its share of the torque and its limit.

    Between stamps a command steps, at a moment that the delay moves: told and recorded are means around each time.

    Args:
        run: a recording.
        joints: all joints of the arm.
        joint: which.
        servo: its drive.
        delay: s.
        time: (n,) s.
        smooth: whether a position is taken as smoothed rather than as recorded.
    """
    middles = 0.5 * (time[1:] + time[:-1])
    edges = np.concatenate([[2.0 * time[0] - middles[0]], middles, [2.0 * time[-1] - middles[-1]]])
    told = mean_held(run.channels[f"{TOLD[servo.law]}.{joint}"], edges - delay)
    if servo.law == "position" and not smooth:
        q = run.channels[f"q.{joint}"]
        at = [np.interp(t, q.time, q.value) for t in (edges[:-1], time, edges[1:])]
        return told - 0.25 * (at[0] + 2.0 * at[1] + at[2])
    if servo.law in ("position", "velocity"):
        motion = measured_motion(run, joints)
        curve = motion.joints[joints.index(joint)].curve
        ends, inner = (curve(np.clip(t, motion.start, motion.end), 0)[:, 0] for t in (edges, time))
        if servo.law == "velocity":
            return told - np.diff(ends) / np.diff(edges)
        return told - (ends[:-1] + 4.0 * inner + ends[1:]) / 6.0  # Simpson's rule
    return told


@kept_alongside
def with_readings(run: Run, joints: tuple[str, ...], servos: tuple[Servo, ...]) -> Run:
    """The run with `tau.<joint>` of the drives that recorded no torque.

    Args:
        run: a recording.
        joints: all joints of the arm.
        servos: with their gains and delays.
    """
    channels = dict(run.channels)
    for servo in servos:
        for joint in servo.joints:
            if not reads(run, joint, servo) or servo.gain is None or f"q.{joint}" not in run.channels:
                continue
            q = run.channels[f"q.{joint}"]
            share, scale = servo.gate(run, joint, q.time)
            asked = (
                scale * servo.gain.value * error(run, joints, joint, servo, servo.delay or 0.0, q.time, smooth=False)
            )
            if servo.damping and servo.law == "position":
                v = measured_motion(run, joints).at(q.time).v[:, joints.index(joint)]
                told = run.channels.get(f"v_cmd.{joint}")
                asked += servo.damping * ((0.0 if told is None else told.held(q.time - (servo.delay or 0.0))) - v)
            given = share * np.clip(asked, -servo.largest, servo.largest)
            if not np.ptp(np.quantile(given, INFORMATIVE)) > 0.0:
                continue  # a joint that was told nothing
            slope = np.gradient(asked, q.time)
            std = (servo.gain.std or 0.0) if servo.unloaded is None else servo.unloaded
            off = np.hypot(servo.determined * std / servo.gain.value * given, TIMED * slope)
            unit = "N" if q.unit == "m" else "N m"
            channels[f"tau.{joint}"] = Reading(q.time, given, unit, float(np.sqrt(np.mean((share * off) ** 2))))
    return run if len(channels) == len(run.channels) else replace(run, channels=channels)
