"""A simulated load cell: the messages of its microcontroller on a pseudo-terminal, in place of a serial port."""

import contextlib
import math
import os
import select
import threading
import time
from collections.abc import Callable
from datetime import datetime

import numpy as np

from armdyn.errors import InputError
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.protocol import (
    MAXIMUM_COUNTS,
    MINIMUM_COUNTS,
    SEQUENCE_MODULUS,
    RawLoadCellReading,
    encode_load_cell_line,
)
from pipeline.processes import Closable

EMULATED_OFFSET_COUNTS, EMULATED_NEWTONS_PER_COUNT = 84213.0, 5.6e-6
"""Offset [counts] and scale [N/count] of the simulated cell: a 1 kg cell of 1 mV/V with an HX711."""


class EmulatedPort(Closable):
    """A simulated serial line (Linux and macOS): the microcontroller's end, from which lines are sent.

    Attributes:
        port: name of the serial port at the computer's end.
    """

    def __init__(self) -> None:
        try:
            import tty
        except ImportError as error:
            raise InputError("an emulated load cell needs the pseudo-terminals of Linux or macOS") from error
        self._ours, self._theirs = os.openpty()
        # The port is held open, so that bytes sent before somebody listens are lost without an error, as on a wire.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.port = os.ttyname(self._theirs)
        self._sequence = 0
        self._plugged = True

    def next_line(self, counts: int) -> bytes:
        """Make the line for the next sample, with the next sequence number."""
        reading = RawLoadCellReading(self._sequence, min(max(counts, MINIMUM_COUNTS), MAXIMUM_COUNTS))
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULUS
        return encode_load_cell_line(reading)

    def send(self, data: bytes, patience: float = 0.0) -> bool:
        """Send bytes; returns False if no program reads them within `patience` [s], so that some are lost."""
        while data and self._plugged:
            _, ready, _ = select.select([], [self._ours], [], patience)
            if not ready:
                return False
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._ours, data) :]
        return not data

    def close(self) -> None:
        """Pull the cable; a second call does nothing."""
        if self._plugged:
            self._plugged = False
            os.close(self._ours)
            os.close(self._theirs)


class EmulatedCell(Closable):
    """A simulated load cell whose thread sends noisy samples of a force on a simulated serial line.

    Args:
        rng: source of the noise.
        force: force on the cell [N], constant or a function of time [s].
        scale: force per count [N/count].
        rate: samples per second [Hz].

    Attributes:
        port: name of the serial port on which the samples arrive.
        scale: force per count [N/count].
        rate: samples per second [Hz].
        offset: counts of the cell without a load [counts].
        noise: standard deviation of one sample [counts].
    """

    offset, noise = EMULATED_OFFSET_COUNTS, 40.0

    def __init__(
        self,
        rng: np.random.Generator,
        force: Callable[[float], float] | float = 0.0,
        *,
        scale: float = EMULATED_NEWTONS_PER_COUNT,
        rate: float = 80.0,
    ) -> None:
        self._rng, self.scale, self.rate = rng, scale, rate
        self.set_force(force)
        self._line = EmulatedPort()
        self.port = self._line.port
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated load cell", daemon=True)
        self._thread.start()

    def set_force(self, force: Callable[[float], float] | float) -> None:
        """Set the force on the cell [N], constant or a function of time [s]."""
        self._force: Callable[[float], float] = force if callable(force) else lambda _: force

    def close(self) -> None:
        """Pull the cable; a second call does nothing."""
        self._stop.set()
        self._thread.join()
        self._line.close()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            counts = self.offset + self._force(due) / self.scale + self.noise * self._rng.standard_normal()
            self._line.send(self._line.next_line(round(counts)))
            due += 1.0 / self.rate


def emulated_calibration(noise: float, source: str) -> Calibration:
    """True calibration of a simulated cell; `noise` is the standard deviation of one sample [N]."""
    now = datetime.now().astimezone().replace(microsecond=0)
    return Calibration(EMULATED_OFFSET_COUNTS, 0.0, EMULATED_NEWTONS_PER_COUNT, 0.0, noise, now, source)


def swinging_load(mass: float, length: float, amplitude: float, gravity: float) -> Callable[[float], float]:
    r"""Force of a load that swings freely by a small angle on its string, [N], as a function of time [s].

    :math:`F = m g \cos\varphi + m l \dot\varphi^2` with :math:`\varphi = A \cos(\sqrt{g / l}\, t)`, from mass m [kg],
    length l of the string [m], amplitude A [rad] and free-fall acceleration g [m/s^2].
    """
    frequency = math.sqrt(gravity / length)

    def force(time: float) -> float:
        angle = amplitude * math.cos(frequency * time)
        rate = amplitude * frequency * math.sin(frequency * time)
        return mass * (gravity * math.cos(angle) + length * rate**2)

    return force
