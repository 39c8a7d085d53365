"""A robot that fails on request, and a record of what it was told; the physics behind it stay those of the simulation.

Every fault begins at a time and ends at another; between them a reading, a command or the clock is spoiled.
"""

import math
import os
import threading
from dataclasses import replace
from time import monotonic, sleep

import numpy as np
from simulated_truth import gripper_truth

from pipeline.robot.protocol import ForceSample, JointState

AT_REST = 0.02  # speed along the line of an arm that stands [m/s]; one that moves has 0.1 to 1


class Through:
    """Passes everything on to a simulated robot, and notes every command; subclasses spoil something."""

    def __init__(self, start=0.0, end=math.inf):
        self.start, self.end = start, end
        self.told = []  # (time, q, v, a), or (time,) for a stop

    def around(self, robot):
        self.robot = robot
        return self

    @property
    def active(self):
        return self.start <= self.robot.time < self.end

    @property
    def joint_names(self):
        return self.robot.joint_names

    @property
    def time(self):
        return self.robot.time

    def command(self, q, v, a):
        self.robot.command(q, v, a)
        self.told.append((self.robot.time, np.array(q), np.array(v), np.array(a)))

    def stop(self):
        self.told.append((self.robot.time,))
        self.robot.stop()

    def advance(self, duration):
        self.robot.advance(duration)

    def joint_state(self):
        return self.robot.joint_state()

    def load_cell(self):
        return self.robot.load_cell()


class BadForce(Through):
    """Samples of the load cell pass through `spoil` while the fault is active."""

    def __init__(self, spoil, *when):
        super().__init__(*when)
        self.spoil = spoil

    def load_cell(self):
        return [self.spoil(s) if self.start <= s.time < self.end else s for s in self.robot.load_cell()]


class BadJoints(Through):
    """Readings of the joints pass through `spoil` while the fault is active."""

    def __init__(self, spoil, *when):
        super().__init__(*when)
        self.spoil = spoil

    def joint_state(self):
        state = self.robot.joint_state()
        return self.spoil(state) if self.active else state


class Unplugged(Through):
    """No sample of the load cell arrives any more."""

    def load_cell(self):
        return [s for s in self.robot.load_cell() if not self.active]


class Frozen(Through):
    """The load cell repeats its last sample."""

    last = 0.0

    def load_cell(self):
        samples = self.robot.load_cell()
        if self.active:
            return [ForceSample(s.time, self.last) for s in samples]
        self.last = samples[-1].force if samples else self.last
        return samples


class Stale(Through):
    """The joints' reading does not change any more."""

    def joint_state(self):
        state = self.robot.joint_state()  # asked in every case: the noise of later readings stays the same
        if not self.active:
            self.kept = state
        return self.kept


class Raises(Through):
    """A method raises while the fault is active."""

    def __init__(self, method, error, *when):
        super().__init__(*when)
        healthy = getattr(self, method)

        def broken(*arguments):
            if not self.active:
                return healthy(*arguments)
            if not arguments:
                healthy()  # the noise of later readings stays the same
            raise error

        setattr(self, method, broken)


class Stalls(Through):
    """One wait takes longer than asked for: the loop stood still."""

    def __init__(self, start, longer):
        super().__init__(start)
        self.longer = longer

    def advance(self, duration):
        extra = self.longer if self.active else 0.0
        self.end = self.robot.time if self.active else self.end
        self.robot.advance(duration + extra)


class ClockJumps(Through):
    """The robot's clock shows another time from an instant on."""

    def __init__(self, start, by):
        super().__init__(start)
        self.by = by

    @property
    def time(self):
        return self.robot.time + (self.by if self.active else 0.0)


class Signals(Through):
    """The process gets a signal at an instant, once or more often."""

    def __init__(self, number, start, times=1):
        super().__init__(start)
        self.number, self.times = number, times

    def joint_state(self):
        if self.active and self.times:
            self.times -= 1
            os.kill(os.getpid(), self.number)
        return self.robot.joint_state()


def with_values(which, value, joint=3):
    """A reading of the joints in which one value is another."""

    def spoil(state):
        values = np.array(getattr(state, which))
        values[joint] = value
        return replace(state, **{which: values})

    return spoil


def with_stamp(change):
    """A reading whose time stamp is another."""
    return lambda reading: replace(reading, time=change(reading.time))


def with_force(change):
    """A sample whose force is another."""
    return lambda sample: ForceSample(sample.time, change(sample.force))


def one_joint_fewer(state):
    return JointState(state.time, state.q[:-1], state.v[:-1], state.tau[:-1])


class InRealTime(Through):
    """A simulated robot that goes on by itself, as a real one does: a thread keeps it up with the clock on the wall."""

    def __init__(self, *when):
        super().__init__(*when)
        self._lock, self._ended = threading.Lock(), threading.Event()

    def around(self, robot):
        self._begun = monotonic()
        threading.Thread(target=self._go_on, args=(robot,), daemon=True).start()
        return super().around(robot)

    def leave(self):
        self._ended.set()

    @property
    def time(self):
        return monotonic() - self._begun

    @property
    def active(self):
        return self.start <= self.time

    def _go_on(self, robot):
        while not self._ended.wait(0.002):
            with self._lock:
                robot.advance(max(0.0, self.time - robot.time))

    def advance(self, duration):
        sleep(duration)

    def command(self, q, v, a):
        with self._lock:
            super().command(q, v, a)

    def stop(self):
        with self._lock:
            super().stop()

    def joint_state(self):
        with self._lock:
            return super().joint_state()

    def load_cell(self):
        with self._lock:
            return super().load_cell()

    def speed(self):
        with self._lock:
            return abs(gripper_truth(self.robot).s_velocity)


class Hangs(InRealTime):
    """Asked for the load cell, it does not answer until the arm stands, or for 5 s."""

    def load_cell(self):
        if self.active and not self.hung and self.speed() > 0.1:
            self.hung = True
            begun = monotonic()
            self.fastest = self.speed()
            while (
                not (self.speed() < AT_REST and any(len(told) == 1 for told in self.told)) and monotonic() < begun + 5
            ):
                sleep(0.002)
            self.stood_after = monotonic() - begun
        return super().load_cell()

    hung = False
