"""Live web page of a watch: its state, torque residuals with their bounds, and events; for this computer only."""

import json
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from armdyn.watch.event import WatchEvent
from armdyn.watch.watch import Watch
from pipeline.interrupts import deferred_signals
from pipeline.processes import Closable

LOCAL_HOST = "127.0.0.1"
POINT_SPACING_SECONDS, SHOWN_CURVE_SECONDS = 0.05, 30.0
"""Time between two drawn points, and duration that a curve shows [s]."""
SIGNAL_CHECK_SECONDS = 0.2
"""Time between two looks for a signal [s]."""
MAX_LISTED_EVENTS = 200
"""Largest number of events that the page lists."""
PAGE_FILE = Path(__file__).parent / "templates" / "watch.html"


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that has closed its connection."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class LivePage(Closable):
    """Serves a web page that shows a running watch.

    Args:
        watch: watch to show.
        port: TCP port; None for any free port.

    Raises:
        InputError: the port is not available.
    """

    def __init__(self, watch: Watch, port: int | None) -> None:
        self._watch = watch
        self._points: deque[list[Any]] = deque(maxlen=round(SHOWN_CURVE_SECONDS / POINT_SPACING_SECONDS))
        self._events: deque[dict[str, Any]] = deque(maxlen=MAX_LISTED_EVENTS)
        self._lock, self._ended = threading.Lock(), False
        try:
            self._server = _Server((LOCAL_HOST, port or 0), self._handler())
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}; choose another one, or leave it out") from error
        self.address = f"http://{LOCAL_HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True, name="watch page")
        self._thread.start()

    def take(self, events: Sequence[WatchEvent]) -> None:
        """Add the watch's latest sample and the events that it has just found."""
        step = self._watch.latest
        if step is None:
            return
        with self._lock:
            self._events.extend(event.answer for event in events)
            if step.settled and (
                not self._points or not 0.0 <= step.time - self._points[-1][0] < POINT_SPACING_SECONDS
            ):
                limit = self._watch.touches.thresholds(step)
                mean = step.residual - step.contrast
                self._points.append([step.time, *(np.round(each, 4).tolist() for each in (step.residual, mean, limit))])

    def state(self) -> bytes:
        """Curves and events as JSON, for the page's script."""
        with self._lock:
            state = {
                "channels": list(self._watch.channels.labels), "units": self._watch.units, "points": list(self._points),
                "events": list(self._events), "basis": self._watch.sound.sentence,
                "state": ("ended; " if self._ended else "") + self._watch.coverage.sentence,
            }  # fmt: skip
        return json.dumps(state).encode()

    def open(self) -> None:
        """Open the page in a browser."""
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(self.address,), daemon=True).start()

    def stay(self, say: Callable[[str], None]) -> None:
        """Show that the source has ended, until a signal such as Ctrl-C arrives; `say` is called once that is so."""
        self._ended, stopped = True, threading.Event()
        with deferred_signals(lambda _: stopped.set()):
            say(f"{self.address} stays until Ctrl-C")
            while not stopped.wait(SIGNAL_CHECK_SECONDS):
                pass

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                host = self.headers.get("Host", "").rpartition(":")[0]
                if host not in (LOCAL_HOST, "localhost"):  # DNS rebinding by another web page
                    return self.send_error(403)
                if self.path == "/":
                    return self._answer(PAGE_FILE.read_bytes(), "text/html; charset=utf-8")
                if self.path == "/state":
                    return self._answer(page.state(), "application/json")
                return self.send_error(404)

            def _answer(self, body: bytes, kind: str) -> None:
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        return Handler
