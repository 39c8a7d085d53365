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
    """Listens where a bridge would, under an address of its own, and passes on; a fault begins when it is told so.

    `stopping` is when the program said that its arm is coming to rest [s]; None before.
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
        now, draw = (0.0, text), self._random
        match self.fault:
            case "delays":
                return [(draw.choice((0.0, 0.03, 0.12, 0.4)), text)]
            case "duplicates":
                return [now, now, (draw.uniform(0.0, 0.3), text)]
            case "exchanges":
                held.append(now)
                if len(held) < 4:
                    return []
                found = draw.sample(held, 4)
                held.clear()
                return found
            case "loses":
                return [now] if draw.random() >= 0.7 else []
            case "clock" | "clock back":
                stamp = (message["msg"].get("header") or {}).get("stamp") or {}
                stamp |= {key: int(stamp[key] + CLOCKS[self.fault]) for key in ("secs", "sec") if key in stamp}
                return [(0.0, json.dumps(message))]
            case "stalls":
                time.sleep(1.0)
                self.fault = None
                return [now]
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


CLOCKS = {"clock": 3.0, "clock back": -3.0}
"""By how much a stamp is off [s]."""
LATE = {"delays": 0.4, "duplicates": 0.3, "stalls": 1.0}
"""How late this wire still delivers what was sent before [s]; where nothing is said, at once."""
FAULTS = ("delays", "duplicates", "exchanges", "loses", "clock", "clock back", "stalls", "garbage", "huge", "restarts")
