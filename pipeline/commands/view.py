"""The command `armdyn view`: show a motion in three dimensions, as an HTML file."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from armdyn.quoting import shell_quoted_command
from pipeline.console.options import EffectsOption, JsonOption, RobotChoice
from pipeline.console.outputs import check_outputs, check_overwrite
from pipeline.console.screen import progress_display, write_json_if_file_given

HELP_PANEL = "Recordings"


def view(
    file: Annotated[
        Path, typer.Argument(help="A run or trajectory (CSV, MCAP), a table of 'ik build' (npz), a trial's folder.")
    ],
    choice: RobotChoice,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model of the load or the arm; by default that in a trial's folder.")
    ] = None,
    effects: EffectsOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "--out", help="HTML file to write; by default <name>_view.html in this folder."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file if it exists.")] = False,
    no_browser: Annotated[
        bool,
        typer.Option("--no-browser", help="Do not open the file in a browser; with --output it is never opened."),
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Show a recording, a trajectory, a table or a trial in 3-D: one HTML file that works offline."""
    import urdf
    from armdyn.effects.user import load_effects
    from armdyn.model_file import read_model
    from pipeline.view.reading import scene_of_file
    from pipeline.view.scene import write_scene_page

    page = output or Path(f"{file.resolve().stem}_view.html")
    check_outputs(page, json_file, inputs=[file, *([model] if model else [])])
    check_overwrite(page, force or output is None)
    with progress_display() as say:
        say("reading")
        given = None if model is None else read_model(model, load_effects(effects, stages=None))
        chosen = urdf.load(choice.robot or str(choice.urdf_file), meshes=False) if choice else None
        say("drawing")
        scene = scene_of_file(file, given, chosen)
        write_scene_page(scene, page, shell_quoted_command(*sys.argv[1:]))
    answer = {
        "schema": "armdyn.view/1", "file": str(page), "kind": scene.kind,
        "seconds": float(scene.time[-1] - scene.time[0]), "bodies": [body.name for body in scene.bodies],
        "note": scene.note,
    }  # fmt: skip
    if write_json_if_file_given(json_file, lambda: answer):
        typer.echo(f"view written to {page}" + (f"; {scene.note}" if scene.note else ""))
    if output is None and not no_browser and sys.stdout.isatty():
        import webbrowser

        webbrowser.open(page.resolve().as_uri())
