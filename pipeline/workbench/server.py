"""Serves the workbench on this computer only, until Ctrl-C."""

import socket
import sys
from collections.abc import Callable
from weakref import WeakValueDictionary

import uvicorn
from fastapi import FastAPI, Response
from nicegui import Client, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

from armdyn import __version__
from armdyn.errors import InputError
from pipeline.commands.identify import Inputs
from pipeline.interrupts import noted_signals
from pipeline.report.page import report_style, widget_scripts
from pipeline.view.scene import scene_script, scene_style, three_js
from pipeline.workbench.desk import Desk, key_of
from pipeline.workbench.page import TEMPLATES, Page

HOST = "127.0.0.1"
USUAL_PORT = 8080
ASSETS = "/armdyn"
SWITCH = 1e-3
"""s for which a refit may keep the page's thread waiting at a time."""
DAY = {"Cache-Control": "max-age=86400"}


def listening(port: int | None) -> socket.socket:
    """A socket on this computer: of the port that is asked for, else of the usual one or any that is free.

    Raises:
        InputError: the port is taken.
    """
    for wanted in (USUAL_PORT, 0) if port is None else (port,):
        found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((HOST, wanted))
            return found
        except (OSError, OverflowError) as error:
            found.close()
            problem = error
    raise InputError(f"--port {port}: {problem}; choose another one, or leave it out")


def serve(inputs: Inputs | None, listen: socket.socket, started: Callable[[str], None]) -> None:
    """Serve until a signal comes.

    Args:
        inputs: files that the page opens; None for none.
        listen: where.
        started: told the address.
    """
    desks: WeakValueDictionary[tuple[object, ...], Desk] = WeakValueDictionary()
    first: list[Desk] = []

    def open_desk(wanted: Inputs) -> Desk:
        key = key_of(wanted)
        desk = desks.get(key)
        if desk is None:
            desk = desks[key] = Desk(wanted)
        return desk

    def begun(address: str) -> None:
        started(address)
        if inputs is not None:
            # The browser takes a second to come, in which recordings can be read. Not before the address is printed:
            # reading a URDF keeps what is printed from the terminal.
            first.append(open_desk(inputs))

    async def page(client: Client) -> None:
        ui.add_head_html(_head())
        own = Page(client, inputs, open_desk)
        client.on_delete(own.close)
        await client.connected()
        await own.begin()

    sys.setswitchinterval(SWITCH)
    ui.page("/", title="armdyn workbench", dark=None)(page)
    server = _server(_application(), begun)
    server.run(sockets=[listen])


def _application() -> FastAPI:
    from plotly.offline import get_plotlyjs

    application = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    # A page of elsewhere, whose name is made to point here, gets nothing.
    application.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    scripts: dict[str, Callable[[], str]] = {
        "plotly.js": get_plotlyjs,
        "three.js": three_js,
        "workbench.js": lambda: "\n".join(
            (*widget_scripts(), scene_script(), (TEMPLATES / "workbench.js").read_text(encoding="utf-8"))
        ),
    }
    texts = {name: make() for name, make in scripts.items()}

    def asset(version: str, name: str) -> Response:
        del version  # only there so that another version of armdyn is not taken from the browser's cache
        if name not in texts:
            return Response(status_code=404)
        return Response(texts[name], media_type="text/javascript", headers=DAY)

    application.get(ASSETS + "/{version}/{name}")(asset)
    ui.run_with(application, title="armdyn workbench", dark=None, tailwind=False, show_welcome_message=False,
                binding_refresh_interval=None)  # fmt: skip
    return application


def _head() -> str:
    script = f"<script defer src='{ASSETS}/{__version__}/workbench.js'></script>"
    own = (TEMPLATES / "workbench.css").read_text(encoding="utf-8")
    style = f"<style>{report_style()}\n{scene_style()}\n{own}</style>"
    return f"<meta name='color-scheme' content='light dark'>{style}{script}"


def _server(application: FastAPI, started: Callable[[str], None]) -> uvicorn.Server:
    """A server that ends in order on the first Ctrl-C, at once on the second."""
    server = uvicorn.Server(uvicorn.Config(application, log_level="warning", timeout_graceful_shutdown=1))
    usual = server.startup

    async def startup(sockets: list[socket.socket]) -> None:
        await usual(sockets=sockets)
        if not server.should_exit:
            started(f"http://{HOST}:{sockets[0].getsockname()[1]}")

    def note(_: int) -> None:
        server.should_exit = True

    server.startup = startup
    server.capture_signals = lambda: noted_signals(note)
    return server
