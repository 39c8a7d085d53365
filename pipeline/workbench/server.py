"""Server of the workbench, for this computer only by default; it runs until a signal comes."""

import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Lock, Thread
from typing import NoReturn
from weakref import WeakValueDictionary

import uvicorn
from fastapi import FastAPI, Response
from nicegui import Client, ui

from armdyn import __version__
from armdyn.errors import InputError
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.interrupts import Interrupt, deferred_signals, exit_at_once
from pipeline.processes import THREAD_SWITCH_SECONDS
from pipeline.report.page import template
from pipeline.view.scene import three_js
from pipeline.workbench import files
from pipeline.workbench.background import Session, key_of
from pipeline.workbench.guard import FIELD, Guard
from pipeline.workbench.page import Page

LOOPBACK = "127.0.0.1"
USUAL_PORT = 8080
ASSETS = "/armdyn"
DAY_CACHE = {"Cache-Control": "max-age=86400"}
GRACEFUL_END_SECONDS, FORCED_END_SECONDS = 0.3, 0.7
"""s after a signal for which answers that are under way are waited for, and after which the program ends as it is: what
reads an upload, in a thread, cannot be stopped."""


def listening(port: int | None, host: str = LOOPBACK) -> socket.socket:
    """A listening socket on the requested port, or by default on the usual port or any free one.

    Raises:
        InputError: the port is in use, or the host is no address of this computer.
    """
    for wanted in (USUAL_PORT, 0) if port is None else (port,):
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, wanted, type=socket.SOCK_STREAM)[0]
        except (OSError, UnicodeError) as error:
            raise InputError(f"--host {host}: {error}; give an address of this computer, or leave it out") from error
        found = socket.socket(family, kind, protocol)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind(address)
            return found
        except (OSError, OverflowError) as error:
            found.close()
            problem = error
    raise InputError(f"--host {host} --port {port or USUAL_PORT}: {problem}; choose another one, or leave it out")


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach a server on this host."""
    return host in ("localhost", "::1") or host.startswith("127.")


def serve(
    inputs: ModelAndRunInputs | None,
    listen: socket.socket,
    host: str,
    started: Callable[[str], None],
    closed: Callable[[], None],
) -> NoReturn:
    """Serve until a signal comes, and end this process; Ctrl-C is the usual end.

    Args:
        inputs: files that the page opens; None for none.
        listen: listening socket.
        host: host as the user gave it.
        started: called with the address, which contains the token.
        closed: called at the end.
    """
    files.remove_abandoned()
    writable = files.Writable(Path.cwd())
    sessions: WeakValueDictionary[tuple[object, ...], Session] = WeakValueDictionary()
    first: list[Session] = []

    def open_session(wanted: ModelAndRunInputs) -> Session:
        key = key_of(wanted)
        session = sessions.get(key)
        if session is None:
            session = sessions[key] = Session(wanted)
        return session

    def begun(address: str) -> None:
        started(address)
        if inputs is not None:
            # The browser takes a second to connect, in which recordings are read. Not before the address is printed:
            # while a URDF is read, nothing is printed to the terminal.
            first.append(open_session(inputs))

    async def page(client: Client) -> None:
        ui.add_head_html(_head())
        own = Page(client, inputs, open_session, writable)
        client.on_delete(own.close)
        await client.connected()
        await own.begin()

    sys.setswitchinterval(THREAD_SWITCH_SECONDS)  # a refit must not keep the page waiting
    ui.page("/", title="armdyn workbench", dark=None)(page)
    port = listen.getsockname()[1]
    mine = {"localhost", *([] if is_loopback(host) else [socket.gethostname(), host])}
    guard = Guard(_application(), port, mine)
    shown = host if host not in ("0.0.0.0", "::") else socket.gethostname()
    address = f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/?{FIELD}={guard.token}"
    _run(guard, listen, lambda: begun(address), closed)


def _application() -> FastAPI:
    from plotly.offline import get_plotlyjs

    application = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    own = (("report", "draw.js"), ("report", "overlay.js"), ("view", "scene.js"), ("workbench", "workbench.js"))
    texts = {
        "plotly.js": get_plotlyjs(),
        "three.js": three_js(),
        "workbench.js": "\n".join(template(*name) for name in own),
    }

    def asset(version: str, name: str) -> Response:
        del version  # in the address so that the browser's cache does not return another version of armdyn
        if name not in texts:
            return Response(status_code=404)
        return Response(texts[name], media_type="text/javascript", headers=DAY_CACHE)

    application.get(ASSETS + "/{version}/{name}")(asset)
    ui.run_with(application, title="armdyn workbench", dark=None, tailwind=False, show_welcome_message=False,
                binding_refresh_interval=None)  # fmt: skip
    return application


def _head() -> str:
    script = f"<script defer src='{ASSETS}/{__version__}/workbench.js'></script>"
    styles = (("report", "style.css"), ("view", "scene.css"), ("workbench", "workbench.css"))
    style = "\n".join(template(*name) for name in styles)
    return f"<meta name='color-scheme' content='light dark'><style>{style}</style>{script}"


def _run(
    application: Guard, listen: socket.socket, started: Callable[[], None], closed: Callable[[], None]
) -> NoReturn:
    """Serve until a signal comes; end orderly, or at once where that takes too long."""
    server = uvicorn.Server(uvicorn.Config(application, log_level="critical", timeout_graceful_shutdown=0))
    server.config.timeout_graceful_shutdown = GRACEFUL_END_SECONDS
    usual, received = server.startup, signal.SIGINT

    async def startup(sockets: list[socket.socket]) -> None:
        await usual(sockets=sockets)
        if not server.should_exit:
            started()

    def end(delay: float = 0.0) -> NoReturn:
        time.sleep(delay)
        with ending:  # kept until the process ends
            files.remove_folders()
            closed()
            if received != signal.SIGINT:
                print(f"armdyn: {Interrupt(received)}", file=sys.stderr)
            exit_at_once(received, 0 if received == signal.SIGINT else 128 + received)

    def note(number: int) -> None:
        nonlocal received
        if not server.should_exit:
            received = signal.Signals(number)
            Thread(target=end, args=(FORCED_END_SECONDS,), daemon=True).start()
        server.should_exit = True

    ending = Lock()
    server.startup = startup
    server.capture_signals = lambda: deferred_signals(note)
    server.run(sockets=[listen])
    end()
