"""A bad wire between a program and its rosbridge: messages come late, twice, in another order, or not at all."""

import json
import random
import socket
import threading
import time
from contextlib import suppress

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.server import serve

from pipeline.ros.telemetry import PHASE_TOPIC
from pipeline.trial.experiment import Phase

STOP = Phase.STOP.value


class Middleman:
    """Listens where a bridge would, and passes on; a fault begins when it is told so.

    Args:
        uri: of the real bridge.
        seed: of what is drawn at random.

    Attributes:
        uri: to be used in place of the bridge's.
        stopping: when the program said that its arm is coming to rest [s]; None before.
    """

    def __init__(self, uri, seed=0):
        self._real, self._random = uri, random.Random(seed)
        self.fault, self.stopping, self._clients = None, None, []
        self._server = serve(self._serve, "127.0.0.1", 0, compression=None, max_size=None, close_timeout=0.2)
        self.uri = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.fault = None
        self._server.shutdown()

    def _serve(self, client):
        with connect(self._real, compression=None, max_size=None) as bridge:
            self._clients.append(client)
            threading.Thread(target=self._pass, args=(bridge, client), daemon=True).start()
            self._pass(client, bridge)

    def _pass(self, source, target):
        """Messages of one direction, each at its time; what is held back goes on in its own order."""
        held = []
        with suppress(ConnectionClosed, OSError):
            for text in source:
                for late, each in self._spoiled(text, held):
                    if late:
                        threading.Timer(late, self._send, (target, each)).start()
                    else:
                        target.send(each)
        with suppress(ConnectionClosed, OSError):
            target.close()

    @staticmethod
    def _send(target, text):
        with suppress(ConnectionClosed, OSError):
            target.send(text)

    def _spoiled(self, text, held):
        """What becomes of a message: messages with the time by which each is late [s]."""
        message = json.loads(text)
        if message.get("topic") == PHASE_TOPIC and message.get("op") == "publish" and message["msg"]["data"] == STOP:
            self.stopping = self.stopping or time.monotonic()
        if self.fault is None or message.get("op") != "publish":
            return [(0.0, text)]
        match self.fault:
            case "delays":
                return [(self._random.choice((0.0, 0.03, 0.12, 0.4)), text)]
            case "duplicates":
                return [(0.0, text), (0.0, text), (self._random.uniform(0.0, 0.3), text)]
            case "exchanges":
                held.append(text)
                if len(held) < 4:
                    return []
                self._random.shuffle(held)
                found = [(0.0, each) for each in held]
                held.clear()
                return found
            case "loses":
                return [] if self._random.random() < 0.7 else [(0.0, text)]
            case "clock":
                return [(0.0, json.dumps(_stamped(message, 3.0)))]
            case "clock back":
                return [(0.0, json.dumps(_stamped(message, -3.0)))]
            case "stalls":
                time.sleep(1.0)
                self.fault = None
                return [(0.0, text)]
            case "garbage":
                return [(0.0, text[: len(text) // 2])]
            case "huge":
                return [(0.0, json.dumps({**message, "pad": "x" * 10_000_000}))]
            case "restarts":
                for client in self._clients:
                    with suppress(OSError):
                        client.socket.shutdown(socket.SHUT_RDWR)
                return []
        raise ValueError(self.fault)


LATE = {"delays": 0.4, "duplicates": 0.3, "stalls": 1.0}
"""How late this wire still delivers what was sent before [s]; where nothing is said, at once."""
FAULTS = ("delays", "duplicates", "exchanges", "loses", "clock", "clock back", "stalls", "garbage", "huge", "restarts")


def _stamped(message, by):
    """The message with another time in its header."""
    stamp = (message["msg"].get("header") or {}).get("stamp")
    if isinstance(stamp, dict):
        for key in ("secs", "sec"):
            if key in stamp:
                stamp[key] = int(stamp[key] + by)
    return message
