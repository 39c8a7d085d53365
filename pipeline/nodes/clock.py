"""Time as the scheduler sees it: simulated, as fast as it can be computed, or real."""

import time as wall
from typing import Protocol

from pipeline.robot.protocol import Robot


class Clock(Protocol):
    """Where the time comes from."""

    @property
    def time(self) -> float:
        """Now, s since the start."""
        ...

    def advance_to(self, time: float) -> None:
        """Let the time come."""
        ...


class SimulatedClock:
    """The time of a simulated robot, which moves only while this clock is advanced."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._robot.time

    def advance_to(self, time: float) -> None:
        """Compute what happens until then."""
        remaining = time - self._robot.time
        if remaining > 1e-9:
            self._robot.advance(remaining)


class RealClock:
    """Monotonic time of this computer from the clock's creation on."""

    def __init__(self) -> None:
        self._start = wall.monotonic()

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return wall.monotonic() - self._start

    def advance_to(self, time: float) -> None:
        """Sleep until then; a time that has passed costs nothing."""
        remaining = time - self.time
        if remaining > 0:
            wall.sleep(remaining)
