"""A rosbridge client: JSON messages over one websocket, without a queue of messages to send.

rosbridge keeps Nagle's algorithm on, whatever its settings say, and holds a message back until the one before is
acknowledged. The client therefore acknowledges at once (``TCP_QUICKACK``): a round trip then takes 1 ms, not 11 ms.
"""

import json
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from armdyn.errors import ArmdynError, InputError
from pipeline.processes import Closable, HighPriorityThread
from urdf.bounds import MAX_ROSBRIDGE_MESSAGE_BYTES, ROSBRIDGE_TIMEOUT_SECONDS

Message = Mapping[str, Any]
MessageHandler = Callable[[Message, float], None]
"""Function ``(message, time of its reception [s])``; it runs in the bridge's thread, so it must be fast."""

SEND_TIMEOUT_SECONDS = 0.02
"""Longest time in which the operating system must accept a message [s]: two control cycles."""
CLOSE_TIMEOUT_SECONDS = 1.0
"""Longest time in which the bridge must end the connection after a request to close [s]."""
MAX_BYTES_PER_READ = 1 << 16
"""Largest number of bytes in one read from the connection."""


class BridgeError(ArmdynError):
    """The connection to the bridge is lost, and is not restored."""


class RosBridge(Closable):
    """One connection to rosbridge.

    Any thread may publish. Received messages are handled in a separate thread. Nothing is queued: the operating system
    accepts a message at once, or the connection ends. A lost connection is not restored, so that no robot moves because
    a cable was plugged in again.

    Args:
        uri: address of the bridge, such as ``ws://robot:9090``.
        clock: present time, for the times of reception [s].

    Attributes:
        failure: reason why the connection is lost, as a sentence; None while it works.

    Raises:
        InputError: the address cannot be used, or no bridge answers there.
    """

    def __init__(self, uri: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.uri, self._clock = uri, clock
        self.failure: str | None = None
        self._takers: defaultdict[str, list[MessageHandler]] = defaultdict(list)
        self._answers: dict[str, Message | None] = {}
        self._answered = threading.Condition()
        self._calls = 0
        self._lock = threading.Lock()
        self._parts: list[bytes] = []
        self._connect()
        self._thread = HighPriorityThread(self._receive, "rosbridge")
        self._thread.start()

    @property
    def time(self) -> float:
        """Present time on the clock that gives times of reception [s]."""
        return self._clock()

    def subscribe(
        self, topic: str, kind: str, take: MessageHandler, *, throttle: float = 0.0, every: bool = False
    ) -> None:
        """Call a function with every message of a topic.

        Args:
            topic: name, such as ``/robot/joint_states``.
            kind: type of its messages, such as ``sensor_msgs/JointState``.
            take: function to call with each message and its time of reception [s].
            throttle: shortest time between two messages [s]; the bridge drops messages between them.
            every: whether a delayed bridge passes on every message; otherwise only the newest one.
        """
        self._takers[topic].append(take)
        # A queue of length one keeps the newest message; without a queue all messages are passed on.
        queue, rate = 0 if every else 1, round(1e3 * throttle)
        self._send({"op": "subscribe", "topic": topic, "type": kind, "queue_length": queue, "throttle_rate": rate})

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Announce a topic on which messages will be published.

        For one second afterwards the bridge repeats messages to new subscribers: do not command a motion before.

        Args:
            topic: name of the topic.
            kind: type of its messages.
            latch: whether later subscribers get the last message.
        """
        self._send({"op": "advertise", "topic": topic, "type": kind, "queue_size": 1, "latch": latch})

    def publish(self, topic: str, message: Message) -> None:
        """Send one message on an announced topic.

        Raises:
            InputError: a value is not finite or has no form in JSON; nothing was sent.
            BridgeError: the connection is lost.
        """
        self._send({"op": "publish", "topic": topic, "msg": message})

    def call(self, service: str, given: Mapping[str, Any] | None = None) -> Message:
        """Call a service with arguments by name, and wait for its answer, values by name.

        Raises:
            InputError: no answer arrived, or the service failed.
            BridgeError: the connection is lost.
        """
        with self._answered:
            self._calls += 1
            number = f"call {self._calls}"
            self._answers[number] = None
        self._send({"op": "call_service", "id": number, "service": service, "args": given or {}})
        with self._answered:
            self._answered.wait_for(
                lambda: self._answers[number] is not None or self.failure is not None, ROSBRIDGE_TIMEOUT_SECONDS
            )
            answer = self._answers.pop(number)
        if answer is None:
            self._require_connected()
            raise InputError(
                f"{self.uri}: service {service} did not answer within {ROSBRIDGE_TIMEOUT_SECONDS:g} s: is it running?"
            )
        if answer.get("result") is False:
            raise InputError(f"{self.uri}: service {service} failed: {answer.get('values')}")
        values = answer.get("values")
        return values if isinstance(values, dict) else {}

    def close(self) -> None:
        """Close the connection and end the thread; a second call does nothing."""
        from websockets.exceptions import InvalidState

        with self._lock, suppress(InvalidState):
            self._protocol.send_close()
            self._flush()
        # The other side closes when it has read everything; an earlier end may lose messages.
        self._thread.join(CLOSE_TIMEOUT_SECONDS)
        self._lose("it was closed here")
        self._thread.join(ROSBRIDGE_TIMEOUT_SECONDS)

    def _connect(self) -> None:
        try:
            from websockets.client import ClientProtocol
            from websockets.exceptions import InvalidURI
            from websockets.uri import parse_uri
        except ImportError as error:
            raise InputError("ROS needs the package 'websockets': run pip install 'armdyn[ros]'") from error
        try:
            address = parse_uri(self.uri)
        except (InvalidURI, ValueError) as error:  # the port is too large, or an IPv6 address is incomplete
            raise InputError(f"'{self.uri}' is not the address of a rosbridge: write ws://HOST:9090") from error
        if address.secure:
            raise InputError(f"{self.uri}: encrypted connections are not supported: write ws://HOST:PORT")
        try:
            deadline = time.monotonic() + ROSBRIDGE_TIMEOUT_SECONDS
            self._socket = socket.create_connection((address.host, address.port), ROSBRIDGE_TIMEOUT_SECONDS)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._protocol = ClientProtocol(address, max_size=MAX_ROSBRIDGE_MESSAGE_BYTES)
            self._protocol.send_request(self._protocol.connect())
            self._flush()
            while self._protocol.handshake_exc is None and not self._protocol.events_received():
                left = deadline - time.monotonic()
                if left <= 0.0:  # a server that sends single bytes for ever is not a bridge
                    raise TimeoutError(0, f"its greeting takes longer than {ROSBRIDGE_TIMEOUT_SECONDS:g} s")
                self._socket.settimeout(left)
                self._feed(self._read())
        except (OSError, UnicodeError) as error:  # no name server accepts the name
            error = error if isinstance(error, OSError) else OSError(0, "no host has such a name")
            raise InputError(
                f"{self.uri}: no rosbridge answers there ({error.strerror or error}): start it with 'roslaunch "
                "rosbridge_server rosbridge_websocket.launch' and check host, port and network"
            ) from error
        if self._protocol.handshake_exc is not None:
            self._socket.close()
            raise InputError(f"{self.uri}: what answers is not a rosbridge ({self._protocol.handshake_exc})")
        self._socket.settimeout(SEND_TIMEOUT_SECONDS)

    def _read(self) -> bytes:
        """Read once and acknowledge at once; empty where the other side has ended the connection."""
        data = self._socket.recv(MAX_BYTES_PER_READ)
        if hasattr(socket, "TCP_QUICKACK"):  # Linux only; the option must be set again after every read
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return data

    def _feed(self, data: bytes) -> None:
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()

    def _flush(self) -> None:
        """Hand all data to the operating system; the connection is lost where the system does not accept them."""
        try:
            for data in self._protocol.data_to_send():
                if data:
                    self._socket.sendall(data)
        except TimeoutError:
            self._lose(f"it accepted nothing for {1e3 * SEND_TIMEOUT_SECONDS:.0f} ms")
        except OSError as error:
            self._lose(error.strerror or str(error))

    def _send(self, request: Message) -> None:
        self._require_connected()
        try:
            text = json.dumps(request, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise InputError(f"{request.get('topic', 'a request')} was not sent: {error}") from error
        with self._lock:
            if self.failure is None:
                self._protocol.send_text(text)
                self._flush()
        self._require_connected()

    def _require_connected(self) -> None:
        if self.failure is not None:
            raise BridgeError(self.failure)

    def _lose(self, why: str) -> None:
        if self.failure is None:
            self.failure = f"the connection to the bridge {self.uri} is lost: {why}"
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            with self._answered:
                self._answered.notify_all()

    def _receive(self) -> None:
        """The thread: read until the connection is lost."""
        try:
            while self.failure is None:
                try:
                    data = self._read()
                except TimeoutError:
                    continue
                with self._lock:
                    self._feed(data)
                    frames = self._protocol.events_received()
                    self._flush()  # answers to pings
                for frame in frames:
                    self._take_frame(frame)
                if not data or self._protocol.close_expected():
                    self._lose("it was closed on the other side")
        except Exception as error:
            # Errors of a subscriber too: a message that cannot be read must not go unnoticed.
            self._lose(f"{type(error).__name__}: {error}")
        finally:
            self._socket.close()

    def _take_frame(self, frame: Any) -> None:
        from websockets.frames import Opcode

        if getattr(frame, "opcode", None) not in (Opcode.TEXT, Opcode.CONT, Opcode.BINARY):
            return
        now = self._clock()
        self._parts.append(bytes(frame.data))
        if not frame.fin:
            return
        text, self._parts = b"".join(self._parts), []
        message = json.loads(text, parse_int=_integer)
        if not isinstance(message, dict) or not isinstance(message.get("msg", {}), dict | str):
            raise ValueError("what it sends is not a message of rosbridge")
        self._take(message, now)

    def _take(self, message: Message, now: float) -> None:
        match message.get("op"):
            case "publish":
                for take in tuple(self._takers.get(str(message["topic"]), ())):
                    take(message["msg"], now)
            case "service_response":
                with self._answered:
                    if message.get("id") in self._answers:
                        self._answers[str(message["id"])] = message
                        self._answered.notify_all()


def _integer(text: str) -> int | float:
    """An integer of JSON, which has any number of digits: beyond 64 bits it becomes a float, infinite if too large."""
    return int(text) if len(text) < 20 else float(text)
