"""An emulated load cell without hardware: a microcontroller's messages on a pseudo-terminal."""

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
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS, SEQUENCE_MODULUS, CellReading, encode
from pipeline.processes import Closing

EMULATED_OFFSET, EMULATED_SCALE = 84213.0, 5.6e-6
"""Counts of the empty cell, and newtons per count: a 1 kg cell of 1 mV/V behind an HX711."""


class EmulatedPort(Closing):
    """The microcontroller's end of a serial line; `port` names the computer's end. Linux and macOS only."""

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

    def line(self, counts: int) -> bytes:
        """The line of the next conversion; its sequence number is used up even if the line is never sent."""
        reading = CellReading(self._sequence, min(max(counts, MINIMUM_COUNTS), MAXIMUM_COUNTS))
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULUS
        return encode(reading)

    def send(self, data: bytes, patience: float = 0.0) -> bool:
        """Send bytes unchanged; returns False where no reader takes them for `patience` [s], and the rest is lost."""
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


class EmulatedCell(Closing):
    """A cell with an HX711 and a microcontroller that sends noisy samples of a force from a thread of its own.

    Attributes:
        scale: force per count [N/count].
        rate: samples per second.
        offset: counts of the empty cell.
        noise: standard deviation of one sample [counts].
    """

    offset, noise = EMULATED_OFFSET, 40.0

    def __init__(
        self,
        rng: np.random.Generator,
        force: Callable[[float], float] | float = 0.0,
        *,
        scale: float = EMULATED_SCALE,
        rate: float = 80.0,
    ) -> None:
        self._rng, self.scale, self.rate = rng, scale, rate
        self.hang(force)
        self._line = EmulatedPort()
        self.port = self._line.port
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated load cell", daemon=True)
        self._thread.start()

    def hang(self, force: Callable[[float], float] | float) -> None:
        """Set the pull on the cell from now on [N]: a constant, or a function of the time [s]."""
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
            self._line.send(self._line.line(round(counts)))
            due += 1.0 / self.rate


def emulated_calibration(noise: float, source: str) -> Calibration:
    """True calibration of an emulated cell with `noise` [N] per sample."""
    now = datetime.now().astimezone().replace(microsecond=0)
    return Calibration(EMULATED_OFFSET, 0.0, EMULATED_SCALE, 0.0, noise, now, source)


def swinging_load(mass: float, length: float, amplitude: float, gravity: float) -> Callable[[float], float]:
    r"""Pull of a load that swings freely by a small angle, as a function of time [s].

    :math:`F = m g \cos\varphi + m l \dot\varphi^2` with :math:`\varphi = A \cos(\sqrt{g / l}\, t)`, from mass m [kg],
    length l of the string [m], amplitude A [rad] and free-fall acceleration g [m/s^2].
    """
    frequency = math.sqrt(gravity / length)

    def force(time: float) -> float:
        angle = amplitude * math.cos(frequency * time)
        rate = amplitude * frequency * math.sin(frequency * time)
        return mass * (gravity * math.cos(angle) + length * rate**2)

    return force
