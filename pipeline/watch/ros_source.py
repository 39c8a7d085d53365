"""Samples of a watch from ROS: joint states, with the wrenches of force/torque sensors at their times."""

import math
import queue
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.fault_free import JointSample
from armdyn.watch.observer import MAX_SAMPLE_GAP_SECONDS
from pipeline.interrupts import deferred_signals
from pipeline.ros.bridge import Message, MessageHandler, RosBridge
from pipeline.ros.states import FIRST_STATE_TIMEOUT_SECONDS, JointStateBuffer, missing_state_error
from pipeline.ros.wrenches import WRENCH_TYPE, WrenchBuffer, missing_wrench_error
from pipeline.watch.sources import MAX_QUEUED_SAMPLES, WAIT_SECONDS

RECONNECT_PERIOD_SECONDS = 1.0
"""Time between attempts to connect to a lost bridge again [s]."""


class RosSampleSource:
    """Source of samples from the joint states of a robot behind rosbridge; it sends nothing to the robot.

    A state waits for the wrenches that follow it, between which they are interpolated; after `MAX_SAMPLE_GAP_SECONDS`
    they are missing. After a lost connection it connects again; the samples between are missing.

    Args:
        uri: address of the bridge.
        topic: topic of the joint states.
        channels: the channels of a sample.
        wrenches: topics of the channels' sensors, by sensor.
    """

    def __init__(
        self, uri: str, topic: str, channels: WatchedChannels, wrenches: Mapping[str, str] | None = None
    ) -> None:
        self._uri, self._topic, self._names, self._wrenches = uri, topic, channels.joints, dict(wrenches or {})
        self._asked, self._sensors = channels.asked, channels.sensors
        self._waiting: queue.Queue[JointSample] = queue.Queue(MAX_QUEUED_SAMPLES)
        self._silent = set(self._sensors)
        self._ended = False

    def samples(self) -> Iterator[JointSample | None]:
        """Samples until a signal (SIGINT, SIGTERM) arrives, with times since the first sample on this computer's clock.

        None stands for a while without one; a state that cannot be read has the value nan throughout.

        Raises:
            InputError: no connection, no states of these joints, states without torques, or no wrenches.
        """
        with ExitStack() as stack:
            stack.enter_context(deferred_signals(lambda _: setattr(self, "_ended", True)))
            bridge = stack.enter_context(self._connected())
            start, begun, torques = None, time.monotonic(), not self._asked[: len(self._names)].any()
            while not self._ended:
                try:
                    stamp, q, read = self._waiting.get(timeout=WAIT_SECONDS)
                except queue.Empty:
                    if start is not None:
                        yield None
                    if bridge.failure is not None:
                        bridge = self._reconnected(stack) or bridge
                    elif start is None and time.monotonic() - begun > FIRST_STATE_TIMEOUT_SECONDS:
                        raise missing_state_error(self._topic, self._names) from None
                    continue
                torques = torques or bool(np.isfinite(read[: len(self._names)]).all())
                if time.monotonic() - begun > FIRST_STATE_TIMEOUT_SECONDS:
                    if not torques:
                        raise InputError(f"{self._topic}: no efforts are sent: a watch needs the torques of the joints")
                    if self._silent:
                        raise missing_wrench_error(bridge, (self._wrenches[name] for name in sorted(self._silent)))
                start = stamp if start is None else start
                yield stamp - start, q, read

    def _connected(self) -> RosBridge:
        bridge, joints, newest = RosBridge(self._uri), JointStateBuffer(self._names), -math.inf
        sensed, states = {name: WrenchBuffer() for name in self._sensors}, deque[JointSample]()

        def take(message: Message, now: float) -> None:
            nonlocal newest
            unreadable = joints.unreadable
            joints.take(message, now)
            if joints.unreadable > unreadable and newest > -math.inf:
                nothing = np.full(len(self._names), np.nan)
                states.append((now, nothing, nothing))
            state = joints.latest
            if state is not None and state.time > newest:
                newest = state.time
                states.append((state.time, np.array(state.q), np.array(state.tau)))
            join()

        def join() -> None:
            while states and (
                all(of.newest >= states[0][0] for of in sensed.values())
                or states[-1][0] - states[0][0] > MAX_SAMPLE_GAP_SECONDS
            ):
                time, q, tau = states.popleft()
                self._put((time, q, np.concatenate([tau, *(of.at(time) for of in sensed.values())])))

        def taker(name: str) -> MessageHandler:
            def take_wrench(message: Message, now: float) -> None:
                sensed[name].take(message, now)
                if sensed[name].newest > -math.inf:
                    self._silent.discard(name)
                join()

            return take_wrench

        for name in self._sensors:
            bridge.subscribe(self._wrenches[name], WRENCH_TYPE, taker(name), every=True)
        bridge.subscribe(self._topic, "sensor_msgs/JointState", take, every=True)
        return bridge

    def _put(self, sample: tuple[float, FloatArray, FloatArray]) -> None:
        while True:
            try:
                return self._waiting.put_nowait(sample)
            except queue.Full:
                self._waiting.get_nowait()

    def _reconnected(self, stack: ExitStack) -> RosBridge | None:
        time.sleep(RECONNECT_PERIOD_SECONDS)
        try:
            return stack.enter_context(self._connected())
        except InputError:
            return None
