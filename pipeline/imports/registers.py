"""Registers of servo drives: which channel a raw number of a log is, its scale, and how it writes negative numbers.

All scales are the makers', "Control Table" of

- Robotis X series: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/, .../xl430-w250/, .../xm430-w350/,
  .../xm540-w270/; MX with protocol 2.0: https://emanual.robotis.com/docs/en/dxl/mx/mx-106-2/. Negative numbers are
  two's complements of 2 or 4 bytes. Full duty is 885, 0.113 % a count.
- Robotis MX with protocol 1.0 (its registers are called speed, not velocity):
  https://emanual.robotis.com/docs/en/dxl/mx/mx-106/. Bit 10 is the sign.
- Feetech STS and SMS: http://doc.feetech.cn, "STS Series Memory Table", in English
  https://wiki.aifitlab.com/feetech-servo-motor-docs/feetech-sts-servo-memory-table-analysis. The sign is bit 15, of
  the load bit 10: https://github.com/huggingface/lerobot, ``src/lerobot/motors/feetech/tables.py``, and ``SMS_STS.cpp``
  of Feetech's library, which also has bit 15 for the current. A count of speed is 1 or 50 counts of position per
  second, by bit 2 of the register Phase.

Every encoder here has 4096 counts a turn, and its middle, 2048, is taken as the joint's zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray

COMPLEMENT, SIGN_BIT = "complement", "bit"
"""How a register writes a negative number: ``complement 16`` of 16 bits, or with the sign in ``bit 15``."""


@dataclass(frozen=True)
class Register:
    """A register of a servo drive; its value is ``scale * count * (unit) + offset``.

    Attributes:
        quantity: quantity of the channel, such as ``"q"``.
        unit: unit of the value.
        scales: units a count; further scales are those of other settings of the drive.
        offset: offset with its unit; empty for none.
        negative: how it writes negative numbers, ``"complement BITS"`` or ``"bit NUMBER"``; empty where it has none.
        doubt: reason why a person must look; empty where the meaning is certain.
    """

    quantity: str
    unit: str
    scales: tuple[float, ...] = (1.0,)
    offset: str = ""
    negative: str = ""
    doubt: str = ""


_TURN, _MIDDLE = (1.0 / 4096.0,), "-180 deg"
_LIMIT_DOUBT = "the commanded speed, or a limit of it?"
_LOAD_DOUBT = "the drive's own estimate of its output"


def _series(
    position: str, speed: tuple[str, str, tuple[float, ...], str], *further: tuple[str, Register]
) -> Mapping[tuple[str, ...], Register]:
    """Registers that every series has, and `further` ones; `speed` is its name, unit, scales and sign."""
    name, unit, scales, negative = speed
    found = {
        "present position": Register("q", "turn", _TURN, _MIDDLE, position),
        "goal position": Register("q_cmd", "turn", _TURN, _MIDDLE, position),
        f"present {name}": Register("v", unit, scales, negative=negative),
        f"goal {name}": Register("v_cmd", unit, scales, negative=negative, doubt=_LIMIT_DOUBT),
        "torque enable": Register("enabled", "1"),
        "present voltage": Register("voltage", "V", (0.1,)),
        "present input voltage": Register("voltage", "V", (0.1,)),
        **dict(further),
    }
    return {tuple(words.split()): register for words, register in found.items()}


def _current(milliamperes: float, negative: str) -> tuple[str, Register]:
    return "present current", Register("current", "mA", (milliamperes,), negative=negative)


def _load(negative: str, doubt: str = "") -> tuple[str, Register]:
    return "present load", Register("duty", "1", (0.001,), negative=negative, doubt=doubt)


_WORD, _LONG = f"{COMPLEMENT} 16", f"{COMPLEMENT} 32"
_VELOCITY = ("velocity", "rpm", (0.229,), _LONG)
_PWM = ("present pwm", Register("duty", "1", (0.00113,), negative=_WORD))
_XM = _series(_LONG, _VELOCITY, _PWM, _current(2.69, _WORD))
_X330 = _series(_LONG, _VELOCITY, _PWM, _current(1.0, _WORD))
_XL430 = _series(_LONG, _VELOCITY, _PWM, _load(_WORD, _LOAD_DOUBT))
_MX_1 = _series(_LONG, ("speed", "rpm", (0.114,), f"{SIGN_BIT} 10"), _load(f"{SIGN_BIT} 10", _LOAD_DOUBT))
_MX_2 = _series(_LONG, _VELOCITY, _PWM)
_STS = _series(
    f"{SIGN_BIT} 15",
    ("velocity", "turn/s", (1.0 / 4096.0, 50.0 / 4096.0), f"{SIGN_BIT} 15"),
    _load(f"{SIGN_BIT} 10"),
    _current(6.5, f"{SIGN_BIT} 15"),
)
_STS = {**_STS, **{(word, "speed"): _STS[word, "velocity"] for word in ("present", "goal")}}

REGISTERS: Mapping[str, Mapping[tuple[str, ...], Register]] = {
    "xl330": _X330,
    "xl430": _XL430,
    "2xl430": _XL430,
    "xm430": _XM,
    "xm540": _XM,
    "mx64": {**_MX_1, **_MX_2},
    "mx106": {**_MX_1, **_MX_2, ("present", "current"): _current(3.36, _WORD)[1]},
    "sts3215": _STS,
    "sts3250": _STS,
}
"""Registers by series of drives, then by the words of their names; ``xl330-m288`` is of the series ``xl330``."""


def decoded(value: FloatArray, negative: str) -> tuple[FloatArray, int]:
    """Signed numbers (n,) from a register's raw ones (n,), and how many of them were negative.

    A column that has negative numbers was decoded by whoever recorded it, and remains unchanged.

    Args:
        value: raw numbers; nan for a missing sample.
        negative: how the register writes negative numbers, see `Register`; empty for not at all.

    Raises:
        InputError: a number has more bits than the register.
    """
    if not negative or (value < 0.0).any():
        return value, 0
    kind, _, number = negative.partition(" ")
    half = 2.0 ** (int(number) - (kind == COMPLEMENT))
    beyond = value[value >= 2.0 * half]
    if beyond.size:
        raise InputError(
            f"{beyond[0]:.10g} has more bits than negative = '{negative}' says: give another 'negative', or leave "
            "it out"
        )
    wrapped = value >= half
    mended = value - 2.0 * half if kind == COMPLEMENT else half - value
    return np.where(wrapped, mended, value), int(np.count_nonzero(wrapped))


def fitting_complement(values: Sequence[FloatArray], register: Register) -> str:
    """How a column writes negative numbers: of a register of 4 bytes, a log may hold only the lower 2 bytes.

    A position beyond 32767 counts is one of many turns, unless it jumps there from below within a sample.
    """
    if register.negative != _LONG:
        return register.negative
    half = 2.0**15
    most = max((float(np.nanmax(value)) for value in values if np.isfinite(value).any()), default=0.0)
    if not half <= most < 2.0 * half:
        return register.negative
    jumps = any((np.abs(np.diff(value[np.isfinite(value)])) > half).any() for value in values)
    return _WORD if jumps or register.quantity in ("v", "v_cmd") else register.negative
