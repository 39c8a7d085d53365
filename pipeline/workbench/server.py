"""Web server of the workbench, by default for this computer only; it runs until a signal arrives."""

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
from pipeline.report.page import template_text
from pipeline.view.scene import three_js_source
from pipeline.workbench import files
from pipeline.workbench.background import WorkbenchComputingThread, inputs_key
from pipeline.workbench.guard import TOKEN_FIELD, AccessGuard
from pipeline.workbench.page import WorkbenchPage

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8080
ASSETS_PATH = "/armdyn"
ONE_DAY_CACHE_HEADER = {"Cache-Control": "max-age=86400"}
MAX_SECONDS_TO_FINISH_ANSWERS, FORCED_END_SECONDS = 0.3, 0.7
"""Time after a signal for which started answers may be finished, and time after which the program ends in any case,
because a thread that reads an upload cannot be stopped [s]."""


def listening_socket(port: int | None, host: str = LOOPBACK) -> socket.socket:
    """A socket that is bound to an address of this computer.

    Args:
        port: TCP port; None for the default port, or any free port if that one is in use.
        host: name or address of this computer.

    Raises:
        InputError: the port is in use, or the host is not an address of this computer.
    """
    for wanted in (DEFAULT_PORT, 0) if port is None else (port,):
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
    raise InputError(f"--host {host} --port {port or DEFAULT_PORT}: {problem}; choose another one, or leave it out")


def is_loopback(host: str) -> bool:
    """Whether a server on this host name or address can be reached from this computer only."""
    return host in ("localhost", "::1") or host.startswith("127.")


def serve_workbench(
    inputs: ModelAndRunInputs | None,
    listen: socket.socket,
    host: str,
    started: Callable[[str], None],
    closed: Callable[[], None],
) -> NoReturn:
    """Serve the workbench until a signal such as Ctrl-C arrives, then end this process.

    Args:
        inputs: files that the page opens; None for none.
        listen: bound socket.
        host: host name or address as the user gave it.
        started: called with the page's address, which contains the secret token.
        closed: called at the end.
    """
    files.remove_abandoned_page_folders()
    writable = files.WritableFileCheck(Path.cwd())
    sessions: WeakValueDictionary[tuple[object, ...], WorkbenchComputingThread] = WeakValueDictionary()
    first: list[WorkbenchComputingThread] = []

    def open_session(wanted: ModelAndRunInputs) -> WorkbenchComputingThread:
        key = inputs_key(wanted)
        session = sessions.get(key)
        if session is None:
            session = sessions[key] = WorkbenchComputingThread(wanted)
        return session

    def begun(address: str) -> None:
        started(address)
        if inputs is not None:
            # The browser takes a second to connect, in which recordings are read. Not before the address is printed:
            # while a URDF is read, nothing is printed to the terminal.
            first.append(open_session(inputs))

    async def page(client: Client) -> None:
        ui.add_head_html(_head())
        own = WorkbenchPage(client, inputs, open_session, writable)
        client.on_delete(own.close)
        await client.connected()
        await own.begin()

    sys.setswitchinterval(THREAD_SWITCH_SECONDS)  # a refit must not keep the page waiting
    ui.page("/", title="armdyn workbench", dark=None)(page)
    port = listen.getsockname()[1]
    mine = {"localhost", *([] if is_loopback(host) else [socket.gethostname(), host])}
    guard = AccessGuard(_application(), port, mine)
    shown = host if host not in ("0.0.0.0", "::") else socket.gethostname()
    address = f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/?{TOKEN_FIELD}={guard.token}"
    _run(guard, listen, lambda: begun(address), closed)


def _application() -> FastAPI:
    from plotly.offline import get_plotlyjs

    application = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    own = (("report", "draw.js"), ("report", "overlay.js"), ("view", "scene.js"), ("workbench", "workbench.js"))
    texts = {
        "plotly.js": get_plotlyjs(),
        "three.js": three_js_source(),
        "workbench.js": "\n".join(template_text(*name) for name in own),
    }

    def asset(version: str, name: str) -> Response:
        del version  # in the address so that the browser's cache does not return another version of armdyn
        if name not in texts:
            return Response(status_code=404)
        return Response(texts[name], media_type="text/javascript", headers=ONE_DAY_CACHE_HEADER)

    application.get(ASSETS_PATH + "/{version}/{name}")(asset)
    ui.run_with(application, title="armdyn workbench", dark=None, tailwind=False, show_welcome_message=False,
                binding_refresh_interval=None)  # fmt: skip
    return application


def _head() -> str:
    script = f"<script defer src='{ASSETS_PATH}/{__version__}/workbench.js'></script>"
    styles = (("report", "style.css"), ("view", "scene.css"), ("workbench", "workbench.css"))
    style = "\n".join(template_text(*name) for name in styles)
    return f"<meta name='color-scheme' content='light dark'><style>{style}</style>{script}"


def _run(
    application: AccessGuard, listen: socket.socket, started: Callable[[], None], closed: Callable[[], None]
) -> NoReturn:
    """Serve until a signal arrives; then end in order, or at once if that takes too long."""
    server = uvicorn.Server(uvicorn.Config(application, log_level="critical", timeout_graceful_shutdown=0))
    server.config.timeout_graceful_shutdown = MAX_SECONDS_TO_FINISH_ANSWERS
    usual, received = server.startup, signal.SIGINT

    async def startup(sockets: list[socket.socket]) -> None:
        await usual(sockets=sockets)
        if not server.should_exit:
            started()

    def end(delay: float = 0.0) -> NoReturn:
        time.sleep(delay)
        with ending:  # kept until the process ends
            files.remove_page_folders()
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
