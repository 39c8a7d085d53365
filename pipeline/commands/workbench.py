"""The command `armdyn workbench`: open a local web page on which a user adds effects and sees the error fall."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from armdyn.errors import InputError
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.console.options import EffectsOption, JsonOption, NoBrowserOption
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import progress_display, write_json

HELP_PANEL = "What a model lacks"


def workbench(
    model: Annotated[
        Path | None,
        typer.Argument(metavar="[M.toml]", help="Model file; without it, a model is created or uploaded on the page."),
    ] = None,
    runs: Annotated[list[Path] | None, typer.Argument(metavar="[RUN...]", help="Recordings: CSV or MCAP.")] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option("--held-out", help="A recording that is predicted and never fitted; may be repeated."),
    ] = None,
    effects: EffectsOption = None,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the web page; by default 8080, or another free port.")
    ] = None,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Network address of the page; with the default only this computer can open it."
        ),
    ] = "127.0.0.1",
    no_browser: NoBrowserOption = False,
    json_file: JsonOption = None,
) -> None:
    """Open a web page to add effects, change parameters, see the error fall and save the model. Ctrl-C ends it."""
    check_outputs(json_file)
    if model is not None and not model.is_file():
        raise InputError(f"{model}: no such file: make a model with 'armdyn new', or start one on the page")
    for run in (*(runs or ()), *(held_out or ())):
        if not run.is_file():
            raise InputError(f"{run}: no such file")
    with progress_display() as say:
        say("starting")
        try:
            from pipeline.workbench.server import is_loopback, listening_socket, serve_workbench
        except ModuleNotFoundError as error:
            if error.name is None or error.name.partition(".")[0] in ("pipeline", "armdyn", "urdf", "ik"):
                raise
            raise InputError(
                "the workbench needs the package 'nicegui': run pip install 'armdyn[workbench]'"
            ) from error
        listen = listening_socket(port, host)

    if not is_loopback(host):
        typer.echo(
            f"warning: --host {host} lets other computers in, and nothing is encrypted: who sees the address on its "
            "way can read and write files here",
            err=True,
        )

    def started(address: str) -> None:
        if json_file is not None:
            write_json({"schema": "armdyn.workbench/1", "address": address}, json_file)
        if json_file != Path("-"):
            typer.echo(f"workbench at {address} for you alone; each tab has its own choice; Ctrl-C ends it")
        if not no_browser and sys.stdout.isatty():
            import webbrowser
            from threading import Thread

            Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some browsers block until they end

    def closed() -> None:
        if json_file != Path("-"):
            print("workbench closed", flush=True)

    inputs = None if model is None else ModelAndRunInputs(model, runs or [], held_out, None, effects)
    serve_workbench(inputs, listen, host, started, closed)
