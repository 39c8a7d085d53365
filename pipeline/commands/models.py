"""`armdyn new` and `armdyn effects`: a base model, and the effects that it can have."""

from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.commands.identify import EffectsOption
from pipeline.commands.output import JsonOption, check_outputs, to_screen, write_json

commands = typer.Typer(help="Make a base model.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.add_typer(commands, name="new")
    app.command()(effects)


@commands.command()
def pendulum(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help='What is known: mass="80 g +/- 0.4 g"; without +/- a first guess.'),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """A load on a string below a moving gripper: length and mass."""
    from armdyn.errors import InputError
    from armdyn.model_file import ModelFile, base_pendulum, write_model_file

    known: dict[str, str] = {}
    for setting in settings or ():
        name, equals, text = setting.partition("=")
        if not equals or not text.strip():
            raise InputError(f'--set {setting}: write it as --set mass="80 g +/- 0.4 g"')
        if name.strip() in known:
            raise InputError(f"--set {setting}: '{name.strip()}' is set twice: give it once")
        known[name.strip()] = text
    check_outputs(model, json_file)
    file = ModelFile(base_pendulum(known), {})
    _check_target(model)
    write_model_file(model, file)
    _say(model, file, json_file)


@commands.command()
def arm(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    urdf: Annotated[str | None, typer.Option(help="Description of the robot.")] = None,
    robot: Annotated[str | None, typer.Option(help="Name of a known robot, such as baxter.")] = None,
    joints: Annotated[
        str | None, typer.Option(help="Names from base to tool, with commas; the longest chain when not given.")
    ] = None,
    tool: Annotated[str | None, typer.Option(help="Link that carries the tool.")] = None,
    json_file: JsonOption = None,
) -> None:
    """The rigid bodies of any URDF, held against joint torques."""
    from armdyn.arm.model import arm_model
    from armdyn.errors import InputError
    from armdyn.model_file import ModelFile, write_model_file

    if (urdf is None) == (robot is None):
        raise InputError("an arm needs either --urdf FILE or --robot baxter")
    check_outputs(model, json_file)
    names = [name.strip() for name in joints.split(",") if name.strip()] if joints is not None else None
    made = arm_model(urdf, robot, names, tool=tool)
    description: dict[str, Any] = {"robot": robot} if robot is not None else {"urdf": str(Path(str(urdf)).resolve())}
    description["joints"] = list(made.joints)
    if tool is not None:
        description["tool"] = tool
    file = ModelFile(made, description)
    _check_target(model)
    write_model_file(model, file)
    _say(model, file, json_file)


def _say(path: Path, file: Any, json_file: Path | None) -> None:
    model = file.model
    if json_file is not None:
        answer = {
            "schema": "armdyn.model/1",
            "file": str(path),
            "base": model.base,
            "effects": [],
            "parameters": {
                n: {"value": p.value, "unit": p.unit} for n, p in model.parameters.items() if p.scope == "shared"
            },
            **file.description,
        }
        write_json(answer, json_file)
    if json_file != Path("-"):
        what = ", ".join(f"{n} {p.value:g} {p.unit}" for n, p in model.parameters.items() if p.scope == "shared")
        typer.echo(f"{path}: {model.base}" + (f", {what}" if what else "") + _joints(file.description))


def _joints(description: dict[str, Any]) -> str:
    return f", joints {', '.join(description['joints'])}" if "joints" in description else ""


def _check_target(model: Path) -> None:
    """A model may take the place of a model, not of a recording.

    Raises:
        InputError: the file is there and is no model file.
    """
    from armdyn.errors import InputError

    if model.is_file() and model.suffix != ".toml":
        raise InputError(f"{model} exists and is no model file: choose another name")


def effects(effects_file: EffectsOption = None, json_file: JsonOption = None) -> None:
    """Show the physical effects that a model can have, with their parameters."""
    from armdyn.effects.catalogue import CATALOGUE
    from armdyn.effects.effect import STAGES, Effect
    from armdyn.effects.user import load_effects

    known = (*CATALOGUE.values(), *(load_effects(effects_file) if effects_file is not None else ()))

    def answer(effect: Effect) -> dict[str, Any]:
        parameters = {
            f"{effect.name}.{short}": {
                "unit": q.unit, "null": q.null, "typical": q.typical, "meaning": q.summary, "scope": q.scope,
                "lower": q.lower if q.lower > float("-inf") else None,
                "upper": q.upper if q.upper < float("inf") else None,
            }
            for short, q in effect.quantities.items()
        }  # fmt: skip
        return {
            "name": effect.name, "acts_on": effect.acts_on, "summary": effect.summary, "source": effect.source,
            "parameters": parameters,
        }  # fmt: skip

    if json_file is not None:
        write_json({"schema": "armdyn.effects/1", "effects": [answer(effect) for effect in known]}, json_file)
    if json_file == Path("-"):
        return
    console = to_screen()
    for stage in STAGES:
        console.print(f"[bold]{stage}[/]")
        for effect in (e for e in known if e.acts_on == stage):
            console.print(f"  [cyan]{effect.name}[/]  {effect.summary}")
            for short, q in effect.quantities.items():
                bounds = f"{q.lower:g} to {q.upper:g}".replace("-inf", "any").replace("inf", "any")
                console.print(
                    f"    {effect.name}.{short}  {q.unit}: {q.summary}; typical {q.typical:g}, {bounds}", style="dim"
                )
            console.print(f"    {effect.source}", style="dim italic")
