"""A rosbridge without ROS: what it does with messages, on a loopback port, and the faults that it can have."""

import contextlib
import itertools
import json
import socket
import threading
from collections import defaultdict

import pytest
from ros_wire.messages import TOPICS
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from pipeline.ros.bridge import RosBridge


class LoopbackBridge:
    """Passes every published message on to all subscribers of its topic, the publisher included, as rosbridge does.

    `requests` are all that clients sent, `answers` what services give, by name.
    """

    def __init__(self):
        self.requests, self.answers = [], {}
        self._subscribers = defaultdict(set)
        self._changed = threading.Condition(threading.RLock())
        self._clients = set()
        self.stopped = threading.Event()
        self._listening = threading.Event()
        self._listening.set()
        self._server = serve(self._serve, "127.0.0.1", 0, compression=None, max_size=None, close_timeout=0.5)
        self.uri = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def published(self, topic):
        with self._changed:  # whoever waits for something may look at it
            return [r["msg"] for r in self.requests if r["op"] == "publish" and r["topic"] == topic]

    def wait_for(self, condition, patience=10.0):
        with self._changed:
            assert self._changed.wait_for(condition, patience), f"in vain; received {self.requests}"

    def wait_subscribed(self, topic):
        self.wait_for(lambda: any(r["op"] == "subscribe" and r["topic"] == topic for r in self.requests))

    def say(self, text, clients=None):
        """Send this as it is to every client, or to some."""
        for client in tuple(self._clients if clients is None else clients):
            with contextlib.suppress(ConnectionClosed):
                client.send(text)

    def publish(self, topic, message):
        """Publish as a node on the robot's side would."""
        self._pass_on({"op": "publish", "topic": topic, "msg": message})

    def stall(self):
        self._listening.clear()

    def drop(self):
        """End every connection without a word."""
        for client in tuple(self._clients):
            with contextlib.suppress(OSError):
                client.socket.shutdown(socket.SHUT_RDWR)

    def close(self):
        self.stopped.set()
        self._listening.set()
        self.drop()
        self._server.shutdown()

    def _serve(self, client):
        self._clients.add(client)
        try:
            for text in client:
                self._listening.wait()
                if self.stopped.is_set():
                    return
                request = json.loads(text)
                with self._changed:
                    self.requests.append(request)
                    self._changed.notify_all()
                self._act(client, request)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)

    def _act(self, client, request):
        match request["op"]:
            case "subscribe":
                self._subscribers[request["topic"]].add(client)
            case "publish":
                self._pass_on(request)
            case "call_service":
                answer = self.answers.get(request["service"])
                if answer is not None:
                    values = answer(request["args"])
                    reply = {"op": "service_response", "id": request["id"], "service": request["service"]}
                    failed = values is None or isinstance(values, str)  # a bridge says in words what failed
                    client.send(json.dumps({**reply, "values": values, "result": not failed}))

    def _pass_on(self, request):
        text = json.dumps({name: request[name] for name in ("op", "topic", "msg")})
        self.say(text, self._subscribers[request["topic"]])


@pytest.fixture
def loopback():
    server = LoopbackBridge()
    yield server
    server.close()


@pytest.fixture
def speaking(loopback):
    """Has the bridge pass on the joint states messages(0), messages(1), ..., 10 ms apart, until the test is over."""

    def speak(messages):
        for k in itertools.count():
            if loopback.stopped.wait(0.01):
                return
            for message in messages(k):
                loopback.publish(TOPICS.joint_states, message)

    threads = []

    def begin(messages):
        threads.append(threading.Thread(target=speak, args=(messages,), daemon=True))
        threads[-1].start()

    yield begin
    loopback.stopped.set()
    for thread in threads:
        thread.join()


@pytest.fixture
def bridge(loopback):
    with RosBridge(loopback.uri) as client:
        yield client
