"""`armdyn new` and `armdyn effects`: a base model, and the effects that it can have."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from armdyn.errors import InputError
from pipeline.console.options import JsonOption, choices, names_in
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import write_answer

PANEL = "Models"


class _Bases(typer.core.TyperGroup):
    """The group of bases, in which ``--base FILE.py`` stands for one of the user's own."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        own = any(arg.partition("=")[0] == "--base" for arg in args)
        return super().parse_args(ctx, ["own", *args] if own else args)


group = typer.Typer(
    help="Make a base model; --base FILE.py M.toml for a base of your own.", no_args_is_help=True, cls=_Bases
)
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help='What is known: mass="80 g +/- 0.4 g"; without +/- a first guess.')
]


ForceOption = Annotated[bool, typer.Option("--force", help="Write over a model that is there and was repaired.")]


@group.command()
def pendulum(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    settings: SetOption = None,
    force: ForceOption = False,
    json_file: JsonOption = None,
) -> None:
    """A load on a string below a moving gripper: length and mass."""
    from armdyn.model_file import ModelFile, base_pendulum

    _write(model, ModelFile(base_pendulum(_known(settings)), {}), json_file, force)


@group.command(name="own", hidden=True)
def own_base(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    base: Annotated[Path, typer.Option("--base", help="Python file with a base of your own.")],
    settings: SetOption = None,
    force: ForceOption = False,
    json_file: JsonOption = None,
) -> None:
    """A base of your own, from a Python file that defines it with @physics."""
    from armdyn.model_file import ModelFile, with_known
    from armdyn.physics.user import load_base

    _write(model, ModelFile(with_known(load_base(base), _known(settings)), {}), json_file, force)


@group.command()
def arm(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    urdf: Annotated[str | None, typer.Option(help="Description of the robot.")] = None,
    mjcf: Annotated[str | None, typer.Option(help="The same in MuJoCo's XML, in place of --urdf.")] = None,
    robot: Annotated[str | None, typer.Option(help="Name of a known robot, such as baxter.")] = None,
    joints: Annotated[
        str | None, typer.Option(help="Names from base to tool, with commas; the longest chain when not given.")
    ] = None,
    tool: Annotated[str | None, typer.Option(help="Link that carries the tool.")] = None,
    force: ForceOption = False,
    json_file: JsonOption = None,
) -> None:
    """The rigid bodies of any URDF or MJCF, held against joint torques."""
    from armdyn.arm.model import arm_model
    from armdyn.model_file import ModelFile

    if sum(given is not None for given in (urdf, mjcf, robot)) != 1:
        raise InputError("an arm needs one of --urdf FILE, --mjcf FILE and --robot baxter")
    made = arm_model(urdf or mjcf, robot, names_in(joints), tool=tool)
    description: dict[str, Any] = {} if robot is None else {"robot": robot}
    description["joints"] = list(made.joints)
    if tool is not None:
        description["tool"] = tool
    _write(model, ModelFile(made, description), json_file, force, choices(made.arm.robot))
    if json_file != Path("-"):
        for link in made.arm.without_inertia:
            typer.echo(
                f"CHECK: link '{link}' has no <inertial>, so that it weighs nothing in the model, and what it weighs "
                "will be told as an effect: write its mass, centre and inertia into the URDF"
            )


def _known(settings: list[str] | None) -> dict[str, str]:
    """What ``--set`` says, by parameter.

    Raises:
        InputError: it cannot be read.
    """
    known: dict[str, str] = {}
    for setting in settings or ():
        name, equals, text = setting.partition("=")
        if not equals or not text.strip():
            raise InputError(f'--set {setting}: write it as --set mass="80 g +/- 0.4 g"')
        if name.strip() in known:
            raise InputError(f"--set {setting}: '{name.strip()}' is set twice: give it once")
        known[name.strip()] = text
    return known


def _write(path: Path, file: Any, json_file: Path | None, force: bool, notes: Sequence[str] = ()) -> None:
    from armdyn.model_file import write_model_file

    check_outputs(path, json_file)
    _check_target(path, force)
    write_model_file(path, file)
    _say(path, file, json_file, notes)


def _say(path: Path, file: Any, json_file: Path | None, notes: Sequence[str]) -> None:
    model = file.model
    shared = {name: p for name, p in model.parameters.items() if p.scope == "shared"}

    def answer() -> dict[str, Any]:
        parameters = {name: {"value": p.value, "unit": p.unit} for name, p in shared.items()}
        about = {"schema": "armdyn.model/1", "file": str(path), "effects": [], "parameters": parameters}
        return {**about, **model.described(path.parent), **file.description}

    if write_answer(json_file, answer):
        what = ", ".join(f"{name} {p.value:g} {p.unit}" for name, p in shared.items())
        typer.echo(f"{path}: {model.base}" + (f", {what}" if what else "") + _joints(file.description))
        for note in notes:
            typer.echo(f"  {note}")
        typer.echo(f"next: armdyn compare {shlex.quote(str(path))} RUN... --report compare.html")


def _joints(description: dict[str, Any]) -> str:
    return f", joints {', '.join(description['joints'])}" if "joints" in description else ""


def _check_target(model: Path, force: bool) -> None:
    """A new model may take the place of a model in which nothing was found yet, not of a recording.

    Raises:
        InputError: the file is there and is no model file, or is one that was repaired or cannot be read.
    """
    import tomllib

    if model.is_file() and model.suffix != ".toml":
        raise InputError(f"{model} exists and is no model file: choose another name")
    if not model.is_file() or force:
        return
    try:
        table = tomllib.loads(model.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        table = {"history": True}
    if "base" not in table or table.get("history") or table.get("effects"):
        raise InputError(f"{model} is there already and holds more than a new model: --force writes over it")
