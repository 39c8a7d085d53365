"""The command `armdyn loadcell`: calibrate an HX711 load cell on a serial port, and show its forces."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import TaskFailedError
from pipeline.console.options import CalibrationOption, JsonOption, SecondsOption
from pipeline.console.screen import write_json

if TYPE_CHECKING:
    from rich.console import Console

    from pipeline.loadcell.emulator import EmulatedCell
    from pipeline.loadcell.faults import LoadCellStatus
    from pipeline.loadcell.fit import KnownWeight
    from pipeline.loadcell.monitor import ForceStatistics

HELP_PANEL = "Experiments"


EMULATED_PORT = "emulated"
SAMPLE_TIMEOUT_SECONDS = 2.0
"""Time without a sample after which a calibration fails [s]."""

group = typer.Typer(help="Calibrate a load cell (HX711 on a serial port), and show its forces.", no_args_is_help=True)

PortArgument = Annotated[
    str, typer.Argument(help="Serial port, such as /dev/ttyUSB0; 'emulated' for a simulated cell without hardware.")
]
BaudOption = Annotated[int, typer.Option(min=1, help="Baud rate of the microcontroller's program.")]


@group.command()
def calibrate(
    port: PortArgument,
    weights: Annotated[
        str, typer.Option(help="Known weights, the empty cell first; '200 g +/- 0.1 g' gives a standard deviation.")
    ] = "0 g, 100 g, 200 g",
    out: Annotated[
        Path | None,
        typer.Option("--out", "--output", help="File to write; by default a file in your settings directory."),
    ] = None,
    samples: Annotated[int, typer.Option(min=40, help="Number of samples per weight.")] = 200,
    baud: BaudOption = 115200,
    json_file: JsonOption = None,
) -> None:
    """Determine offset, scale and noise of a load cell with known weights."""
    import time

    from armdyn.pendulum.physics import STANDARD_GRAVITY
    from pipeline.loadcell.calibration import default_calibration_path
    from pipeline.loadcell.cell import LoadCell
    from pipeline.loadcell.fit import calibrate_cell as guided
    from pipeline.loadcell.fit import parse_weights
    from pipeline.loadcell.monitor import calibration_json, calibration_table

    listed = parse_weights(weights, STANDARD_GRAVITY)
    source = f"armdyn loadcell calibrate {port}: {', '.join(weight.text for weight in listed)}; {samples} samples each"
    # An emulated cell must not take the place of a real one's calibration.
    target = out or default_calibration_path().with_name(
        "loadcell-emulated.toml" if port == EMULATED_PORT else "loadcell.toml"
    )
    console = _console(json_file)
    with _cell(port) as (name, emulated):

        def ask(weight: "KnownWeight") -> None:
            what = "Leave the cell empty" if weight.force == 0.0 else f"Hang {weight.text}"
            if emulated is None:
                status.stop()  # the animation would overwrite the question
                typer.prompt(f"{what}, let it come to rest, press Enter", default="", show_default=False, err=True)
                status.start()
            else:
                console.print(f"{what} (emulated)")
                emulated.set_force(weight.force)
                time.sleep(0.2)  # wait until the earlier samples have arrived

        def progress(weight: "KnownWeight", count: int) -> None:
            status.update(f"{weight.text}: {count} of {samples} samples")

        with (
            LoadCell(name, None, baud=baud, silent_after=SAMPLE_TIMEOUT_SECONDS) as cell,
            console.status("waiting") as status,
        ):
            fit = guided(cell, listed, samples, source, ask, progress, time.sleep)
            rate = cell.status().rate
    console.print(calibration_table(fit))
    fit.save(target)
    if json_file is not None:
        write_json({**calibration_json(fit, rate), "file": str(target)}, json_file)
    console.print(f"written to {target}", highlight=False, soft_wrap=True)


@group.command()
def monitor(
    port: PortArgument,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = None,
    silent_after: Annotated[
        float, typer.Option(min=0.02, help="Time without a sample after which a fault is reported [s].")
    ] = 0.2,
    baud: BaudOption = 115200,
    json_file: JsonOption = None,
) -> None:
    """Show forces and faults of a load cell continuously; exit status 1 if the cell is unreliable at the end."""
    from pipeline.loadcell.calibration import Calibration, default_calibration_path
    from pipeline.loadcell.cell import LoadCell
    from pipeline.loadcell.emulator import emulated_calibration
    from pipeline.loadcell.faults import LoadCellFault
    from pipeline.loadcell.monitor import monitor_json

    console = _console(json_file)
    with _cell(port) as (name, emulated):
        if emulated is not None and calibration is None:
            used = emulated_calibration(emulated.noise * abs(emulated.scale), EMULATED_PORT)
        else:
            used = Calibration.load(calibration or default_calibration_path())
        with LoadCell(name, used, baud=baud, silent_after=silent_after) as cell:
            seen, status, start = _watch(cell, console, seconds)
    if json_file is not None:
        write_json({"port": port, **monitor_json(seen, status, start)}, json_file)
    if not status.reliable:
        worst = next(iter(status.active), LoadCellFault.SILENT)
        raise TaskFailedError(f"{port}: {worst.value}")


def _watch(cell: Any, console: "Console", seconds: float | None) -> tuple["ForceStatistics", "LoadCellStatus", float]:
    """Show the cell until `seconds` after its first sample, Ctrl-C, or a disconnection; returns the start time too."""
    import time

    from rich.live import Live

    from pipeline.interrupts import deferred_signals
    from pipeline.loadcell.faults import LoadCellFault
    from pipeline.loadcell.monitor import ForceStatistics, monitor_table

    seen, start = ForceStatistics(), time.monotonic()
    begin: float | None = None
    status = cell.status()
    if seconds is None:
        console.print("Ctrl-C ends")
    ends: list[int] = []
    with Live(console=console, refresh_per_second=10) as live:
        # Ctrl-C is the usual way to end the display, and not an interruption.
        with deferred_signals(ends.append):
            while status.connected and not ends:
                time.sleep(0.05)
                seen.add(cell.read(), cell.take_events())
                status = cell.status()
                live.update(monitor_table(seen, status, start))
                now = time.monotonic()
                if begin is None and (status.samples or LoadCellFault.SILENT in status.active):
                    begin = now
                if seconds is not None and begin is not None and now - begin >= seconds:
                    break
        seen.add(cell.read(), cell.take_events())
        live.update(monitor_table(seen, status, start))
    if not console.is_terminal:
        console.print()  # rich ends the last line of a live display only on a terminal
    return seen, status, start


@contextmanager
def _cell(port: str) -> "Iterator[tuple[str, EmulatedCell | None]]":
    """Name of the port to open, and the emulated cell behind the port; None for a real cell."""
    if port != EMULATED_PORT:
        yield port, None
        return
    import numpy as np

    from armdyn.pendulum.physics import STANDARD_GRAVITY
    from pipeline.loadcell.emulator import EmulatedCell, swinging_load

    load = swinging_load(mass=0.08, length=0.368, amplitude=0.3, gravity=STANDARD_GRAVITY)
    with EmulatedCell(np.random.default_rng(), load) as cell:
        yield cell.port, cell


def _console(json_file: Path | None) -> "Console":
    from rich.console import Console

    return Console(stderr=json_file == Path("-"))
