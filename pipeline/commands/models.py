"""`armdyn new` and `armdyn effects`: a base model, and the effects that it can have."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from pipeline.commands.identify import EffectsOption
from pipeline.commands.output import JsonOption, answered, check_outputs, to_screen
from pipeline.commands.which_robot import choices, names_in


class _Bases(typer.core.TyperGroup):
    """The group of bases, in which ``--base FILE.py`` stands for one of the user's own."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        own = any(arg.partition("=")[0] == "--base" for arg in args)
        return super().parse_args(ctx, ["own", *args] if own else args)


commands = typer.Typer(
    help="Make a base model; --base FILE.py M.toml for a base of your own.", no_args_is_help=True, cls=_Bases
)
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help='What is known: mass="80 g +/- 0.4 g"; without +/- a first guess.')
]


ForceOption = Annotated[bool, typer.Option("--force", help="Write over a model that is there and was repaired.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.add_typer(commands, name="new")
    app.command()(effects)


@commands.command()
def pendulum(
    model: Annotated[Path, typer.Argument(metavar="M.toml", help="File to write.")],
    settings: SetOption = None,
    force: ForceOption = False,
    json_file: JsonOption = None,
) -> None:
    """A load on a string below a moving gripper: length and mass."""
    from armdyn.model_file import ModelFile, base_pendulum

    _write(model, ModelFile(base_pendulum(_known(settings)), {}), json_file, force)


@commands.command(name="own", hidden=True)
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


@commands.command()
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
    from armdyn.errors import InputError
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
    from armdyn.errors import InputError

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

    if answered(json_file, answer):
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

    from armdyn.errors import InputError

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


def effects(effects_file: EffectsOption = None, json_file: JsonOption = None) -> None:
    """Show the physical effects that a model can have, with their parameters."""
    from armdyn.effects.catalogue import CATALOGUE, STAGES
    from armdyn.effects.effect import Effect
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

    if not answered(json_file, lambda: {"schema": "armdyn.effects/1", "effects": [answer(e) for e in known]}):
        return
    from rich.text import Text

    console = to_screen()
    for stage in STAGES:
        console.print(stage, style="bold")
        for effect in (e for e in known if e.acts_on == stage):
            console.print(Text.assemble("  ", (effect.name, "cyan"), f"  {effect.summary}"))
            for short, q in effect.quantities.items():
                bounds = f"{q.lower:g} to {q.upper:g}".replace("-inf", "any").replace("inf", "any")
                console.print(
                    f"    {effect.name}.{short}  {q.unit}: {q.summary}; typical {q.typical:g}, {bounds}", style="dim"
                )
            console.print(f"    {effect.source}", style="dim italic")
