"""The channels of a recording: their names, their units and their plausible sizes."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError, UnknownNameError
from armdyn.recording.units import si_factor, si_unit, to_base_units
from urdf.bounds import printable_excerpt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ChannelKind:
    """Properties of a kind of channel.

    Attributes:
        units: SI units that its values may have; a joint channel has two, for revolute and prismatic joints.
        measured: whether models predict the channel.
        held: whether each value holds until the next time stamp, as for a command.
    """

    units: tuple[str, ...]
    measured: bool = False
    held: bool = False


PENDULUM_CHANNELS = {
    "gripper_x": ChannelKind(("m",)),  # of the string's upper end along the line, + = robot's left
    "gripper_v": ChannelKind(("m/s",)),
    "gripper_a": ChannelKind(("m/s^2",)),
    "gripper_z": ChannelKind(("m",)),
    "load_force": ChannelKind(("N",), measured=True),
    "swing_angle": ChannelKind(("rad",), measured=True),  # 0 hanging; the load is at gripper_x - l sin(angle)
    "swing_rate": ChannelKind(("rad/s",), measured=True),
}
JOINT_CHANNELS = {
    "q": ChannelKind(("rad", "m")),
    "v": ChannelKind(("rad/s", "m/s")),
    "a": ChannelKind(("rad/s^2", "m/s^2")),
    "tau": ChannelKind(("N m", "N"), measured=True),
    "q_cmd": ChannelKind(("rad", "m"), held=True),  # commanded position
    "v_cmd": ChannelKind(("rad/s", "m/s"), held=True),
    "tau_ff": ChannelKind(("N m", "N")),  # feed-forward torque
    "duty": ChannelKind(("1",)),  # duty cycle of the drive
    "current": ChannelKind(("A",)),
    "voltage": ChannelKind(("V",)),
    "enabled": ChannelKind(("1",)),  # 0 where the drive was off
}
WRENCH_CHANNELS = {
    "fx": ChannelKind(("N",), measured=True),  # what the tool does to the sensor, in the axes of the sensor's frame
    "fy": ChannelKind(("N",), measured=True),
    "fz": ChannelKind(("N",), measured=True),
    "tx": ChannelKind(("N m",), measured=True),  # about the origin of the sensor's frame
    "ty": ChannelKind(("N m",), measured=True),
    "tz": ChannelKind(("N m",), measured=True),
}
NAMED_CHANNELS = {**JOINT_CHANNELS, **WRENCH_CHANNELS}
"""Channels whose name ends in that of a joint or of a force/torque sensor, after a dot."""

MAX_PLAUSIBLE_SIZE_BY_UNIT = {
    "s": 1e10,  # admits the seconds since 1970
    "m": 1e3,
    "m/s": 1e3,
    "m/s^2": 1e5,
    "rad": 1e4,  # admits a joint that turns on and on
    "rad/s": 1e4,
    "rad/s^2": 1e6,
    "N": 1e6,
    "N m": 1e6,
}
"""Largest plausible size per SI unit: beyond it the unit is wrong or the sensor sent garbage."""
MAX_PLAUSIBLE_SIZE_OF_OTHER_UNITS = 1e15
"""Largest plausible size in any other unit: a frequency of light, in Hz, is the largest that anybody records."""
EXTRA_PREFIX = "extra"
"""Prefix, before the dot, of a column with any further quantity, such as ``extra.temperature``."""
EXTRA_CHANNEL_FORM = "'extra.NAME [unit]' with letters, digits and '_', such as 'extra.temperature [degC]'"


MIN_COMPARED_CHANNEL_SAMPLES = 10
"""Least number of samples of a channel for a comparison with a model."""


def is_channel_name(name: str) -> bool:
    """Whether `name` is the name of a channel that recordings may contain."""
    quantity, dot, joint = name.partition(".")
    return name in PENDULUM_CHANNELS or is_auxiliary(name) or (bool(dot and joint) and quantity in NAMED_CHANNELS)


def is_auxiliary(name: str) -> bool:
    """Whether `name` is that of a further recorded quantity of any kind, such as ``extra.temperature``."""
    quantity, _, own = name.partition(".")
    return quantity == EXTRA_PREFIX and own.isidentifier()


def channel_kind(name: str, where: str = "channel") -> ChannelKind:
    """Properties of the channel `name`: its units, and how it is used.

    Raises:
        UnknownNameError: there is no such channel; `where` names the kind of name in the message.
    """
    quantity, _, joint = name.partition(".")
    if not is_channel_name(name):
        if quantity == EXTRA_PREFIX:
            raise InputError(f"{where} '{printable_excerpt(name)}': write a further quantity as {EXTRA_CHANNEL_FORM}")
        raise UnknownNameError(where, name, _valid_names(joint), f"; write a further quantity as {EXTRA_CHANNEL_FORM}")
    if is_auxiliary(name):
        return ChannelKind(("1",))
    return PENDULUM_CHANNELS[name] if name in PENDULUM_CHANNELS else NAMED_CHANNELS[quantity]


def channel_units(name: str, where: str = "channel") -> tuple[str, ...]:
    """SI units that the values of channel `name`, or of ``"time"``, may have.

    Raises:
        UnknownNameError: there is no such channel; `where` names the kind of name in the message.
    """
    return ("s",) if name == "time" else channel_kind(name, where).units


class Conversion(NamedTuple):
    """Conversion of written values to the SI unit `unit`: ``factor * value + zero``."""

    unit: str
    factor: float = 1.0
    zero: float = 0.0

    def __call__(self, value: FloatArray) -> FloatArray:
        """Convert (n,) written values to `unit`."""
        return value if (self.factor, self.zero) == (1.0, 0.0) else value * self.factor + self.zero


def unit_conversion(name: str, unit: str) -> Conversion:
    """Conversion from `unit` to the SI unit of the channel `name`; a further quantity may have any unit.

    Raises:
        UnknownNameError: there is no such channel.
        InputError: the unit is unknown or of another kind than the channel, or a further quantity has none.
    """
    choices = channel_units(name)
    if is_auxiliary(name):
        if not unit:
            raise InputError(f"it has no unit: write it as '{name} [K]', or in whatever it is; '1' is a plain number")
        base, factor, zero = to_base_units(unit)
        return Conversion(unit if (factor, zero) == (1.0, 0.0) else base, factor, zero)
    problems = []
    for si in choices:
        try:
            return Conversion(si, si_factor(unit, si))
        except InputError as error:
            problems.append(error)
    if len(choices) == 1:
        raise problems[0]
    si_unit(unit)  # an unknown unit has its own message
    raise InputError(f"'{unit}' is of another kind than {' and '.join(choices)}: write it in one of these")


def _valid_names(joint: str) -> Iterable[str]:
    of_joints = (f"{quantity}.{joint or '<joint>'}" for quantity in JOINT_CHANNELS)
    of_sensors = (f"{quantity}.{joint or '<sensor>'}" for quantity in WRENCH_CHANNELS)
    return ("time", *PENDULUM_CHANNELS, *of_joints, *of_sensors, f"{EXTRA_PREFIX}.{joint or '<name>'}")


class SampleError(InputError):
    """The value of a sample is impossible, for example too large for any sensor.

    Args:
        index: index of the sample in its channel.
        said: the fault in words.
    """

    def __init__(self, index: int, said: str) -> None:
        self.index, self.fault = index, f"{said}: check its unit, or leave out the sample where the sensor failed"
        super().__init__(f"sample {index}: {self.fault}")


@dataclass(frozen=True, eq=False)
class Channel:
    """One measured quantity with its own time stamps.

    The arrays are copied once and cannot be written to.

    Attributes:
        time: (n,) time stamps, s, strictly increasing.
        value: (n,) values in `unit`, without missing samples.
        unit: SI unit.

    Raises:
        InputError: lengths differ, time does not increase, or a value is missing, infinite or of no possible size.
    """

    time: FloatArray
    value: FloatArray
    unit: str

    def __post_init__(self) -> None:
        time, value = np.array(self.time, dtype=float), np.array(self.value, dtype=float)
        if time.ndim != 1 or time.shape != value.shape:
            raise InputError(f"a channel needs one value per time stamp, not shapes {value.shape} and {time.shape}")
        if not np.isfinite(value).all():
            raise InputError("a channel holds a missing or infinite sample: leave missing samples out")
        check_clock(time)
        for unit, array in (("s", time), (self.unit, value)):
            largest = MAX_PLAUSIBLE_SIZE_BY_UNIT.get(unit, MAX_PLAUSIBLE_SIZE_OF_OTHER_UNITS)
            beyond = np.flatnonzero(np.abs(array) > largest)
            if beyond.size:
                i = int(beyond[0])
                raise SampleError(i, f"{array[i]:.6g} {unit} is beyond {largest:g} {unit}")
        time.setflags(write=False)
        value.setflags(write=False)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "value", value)

    def __len__(self) -> int:
        return self.time.size

    def __reduce__(self) -> tuple[type["Channel"], tuple[FloatArray, FloatArray, str]]:
        return Channel, (self.time, self.value, self.unit)  # pickled arrays forget that they are read-only

    def selected(self, which: npt.NDArray[np.bool_]) -> "Channel":
        """The samples for which (n,) `which` is True."""
        return Channel(self.time[which], self.value[which], self.unit)

    def zero_order_hold_values(self, time: FloatArray) -> FloatArray:
        """(n,) values at (n,) times of a signal that holds each value until the next stamp, as a command does."""
        return np.asarray(self.value[np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, None)])

    def mean_zero_order_hold_values(self, edges: np.ndarray) -> FloatArray:
        """(n,) means between (n + 1,) increasing times of a signal that holds each value until the next stamp."""
        time = np.append(self.time, max(self.time[-1], edges[-1]) + 1.0)
        area = np.interp(edges, time, np.concatenate([[0.0], np.cumsum(self.value * np.diff(time))]))
        area += self.value[0] * np.minimum(edges - time[0], 0.0)
        return np.asarray(np.diff(area) / np.diff(edges))

    def averaged(self, group: int) -> "Channel":
        """Average the values and stamps of groups of successive samples; an incomplete last group is left out.

        Averaging shifts nothing in time and reduces white noise by the square root of `group`; see `Run.spread` for
        curved signals.
        """
        n = len(self) // group * group
        time, value = (a[:n].reshape(-1, group).mean(axis=1) for a in (self.time, self.value))
        return Channel(time, value, self.unit)


@dataclass(frozen=True, eq=False, repr=False)
class DriveReading(Channel):
    """A torque estimated from a drive's own position error; it lacks what the smoothing of positions removes.

    It is therefore compared only within the positions' band, with the noise of differentiated positions.

    Attributes:
        common_error_std: standard deviation of the error that all samples share, in `unit`: that of gain and delay.
        commands: (5, n) commands of the drive at the stamps, in the order of `armdyn.arm.physics.DriveCommands`.
    """

    common_error_std: float = 0.0
    commands: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    def __reduce__(self) -> Any:
        return DriveReading, (self.time, self.value, self.unit, self.common_error_std, self.commands)

    def selected(self, which: npt.NDArray[np.bool_]) -> "DriveReading":
        """The samples for which (n,) `which` is True, with their commands."""
        told = self.commands[:, which] if len(self.commands) else self.commands
        return replace(self, time=self.time[which], value=self.value[which], commands=told)


def check_clock(time: FloatArray) -> None:
    """Check that (n,) time stamps increase.

    Raises:
        InputError: it names the first wrong sample.
    """
    if time.ndim != 1:
        raise InputError(f"time has shape {time.shape}: give one stamp per sample, (n,)")
    if not np.isfinite(time).all():
        raise InputError(f"time is missing at sample {int(np.flatnonzero(~np.isfinite(time))[0])}")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        i = int(late[0])
        raise InputError(f"time does not increase at sample {i + 1}: {time[i]:.9g} s, then {time[i + 1]:.9g} s")


def check_joint_units(channels: Iterable[tuple[str, str]]) -> None:
    """Check that no joint is revolute in one channel and prismatic in another.

    Args:
        channels: name and SI unit of each channel.

    Raises:
        InputError: it names the joint and the two channels.
    """
    first: dict[str, tuple[str, str, int]] = {}
    for name, unit in channels:
        quantity, _, joint = name.partition(".")
        if len(JOINT_CHANNELS.get(quantity, ChannelKind(("",))).units) == 1:
            continue
        slides = JOINT_CHANNELS[quantity].units.index(unit)
        other, other_unit, other_slides = first.setdefault(joint, (name, unit, slides))
        if slides != other_slides:
            raise InputError(f"joint '{joint}' turns and slides: '{other}' is in {other_unit}, '{name}' in {unit}")


_LABEL = re.compile(r"(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]")


def name_and_unit(label: str) -> tuple[str, str]:
    """Split ``"q.elbow [deg]"`` into ``("q.elbow", "deg")``; the unit is empty where none is written."""
    match = _LABEL.fullmatch(label.strip())
    return (match["name"].strip(), match["unit"].strip()) if match else (label.strip(), "")
