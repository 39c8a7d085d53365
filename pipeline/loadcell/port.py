"""Opening a serial port, and saying in one line why it cannot be opened."""

import contextlib
import errno
from pathlib import Path
from typing import Protocol

from armdyn.errors import InputError

BAUD = 115200
POLL = 0.05
"""s; how long a read waits for the first byte, and so how soon a reader notices that it shall end."""


class SerialLine(Protocol):
    """What is used of pyserial's ``Serial``."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        ...

    def read(self, size: int) -> bytes:
        """Up to `size` bytes; fewer, or none, after `POLL` seconds. Raises OSError once the port is gone."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


def open_port(port: str, baud: int = BAUD) -> SerialLine:
    """Open `port` for nobody else.

    Raises:
        InputError: it is missing, forbidden, in use, not a serial port, or does not know the baud rate.
    """
    import serial

    try:
        line = serial.Serial(port, baud, timeout=POLL, exclusive=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{port}: {_reason(port, baud, error)}") from error
    # An FTDI adapter else collects bytes for 16 ms, and every ms of delay shifts the estimated length by 0.25 mm. Other
    # kinds of port do not know this setting.
    with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
        line.set_low_latency_mode(True)
    return line


def _reason(port: str, baud: int, error: OSError | ValueError) -> str:
    if isinstance(error, ValueError):
        return f"baud rate {baud} does not exist: use the one of the microcontroller's program, such as {BAUD}"
    number = error.errno
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"there is no such port: {_present()}"
    if number in (errno.EACCES, errno.EPERM):
        group = "dialout"
        with contextlib.suppress(OSError, KeyError, NotImplementedError):
            group = Path(port).group()
        return f"permission denied: 'sudo usermod -aG {group} $USER', then log in again"
    if number in (errno.EBUSY, errno.EAGAIN):
        return "another program has it open: close that (a serial monitor?) and try again"
    return f"is not a serial port{f' ({error.strerror})' if error.strerror else ''}: {_present()}"


def _present() -> str:
    from serial.tools.list_ports import comports

    names = sorted(info.device for info in comports())
    if not names:
        return "none is present, so plug the microcontroller in, or write 'emulated' to try without one"
    return f"choose one of {', '.join(names)}"
