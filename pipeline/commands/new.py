"""The command `armdyn new`: write the file of a new model without effects."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from armdyn.read_files import allow_overwrite
from pipeline.console.options import JointsOption, JsonOption, ToolOption, split_names
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import write_json_if_file_given

if TYPE_CHECKING:
    from armdyn.model_file import ModelFile

HELP_PANEL = "Models"


class _Bases(typer.core.TyperGroup):
    """The subcommands of `new`; ``--base FILE.py`` without a subcommand is a base model from the user's file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        own = args[:1] != ["own"] and any(arg.partition("=")[0] == "--base" for arg in args)
        return super().parse_args(ctx, ["own", *args] if own else args)


group = typer.Typer(
    help="Write a new model; --base FILE.py M.toml for a base model of your own.", no_args_is_help=True, cls=_Bases
)


DriveOption = Annotated[
    list[str] | None,
    typer.Option(
        "--drive",
        help="Joints whose servos record no torque: sts3215=all, KIND=joint,joint, or of any other kind "
        "NAME:position=all (velocity, torque, current); may be repeated.",
    ),
]


WrenchOption = Annotated[
    list[str] | None,
    typer.Option(
        "--wrench",
        help="Force/torque sensor, as NAME=LINK with the first link that it carries: ft=tool0; may be repeated.",
    ),
]


@dataclass(frozen=True)
class NewModelOptions:
    """Arguments and options of `new`: the model file to write, and where the JSON output goes."""

    model: Annotated[Path, typer.Argument(metavar="M.toml", help="Model file to write.")]
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing model that was repaired.")] = False
    json_file: JsonOption = None


MAX_LISTED_RUNS = 6
"""Largest number of recordings that a proposed command lists, the last one as held out."""
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help='Value of a parameter: mass="80 g +/- 0.4 g"; without +/- it is a first guess, for gravity exact.',
    ),
]


@group.command()
def pendulum(target: NewModelOptions, settings: SetOption = None) -> None:
    """Write the model of a load on a string below a moving gripper, with length, mass and gravity."""
    from armdyn.model_file import ModelFile, base_pendulum

    known = _known(settings)
    _write(target, ModelFile(base_pendulum(known), {}), assumed={"length", "mass"} - known.keys())


@group.command(name="own", hidden=True)
def own_base(
    target: NewModelOptions,
    base: Annotated[Path, typer.Option("--base", help="Python file with a base of your own.")],
    settings: SetOption = None,
) -> None:
    """Write a model from a base model of your own, which a Python file defines with @physics."""
    from armdyn.model_file import ModelFile, with_known_values
    from armdyn.physics.user import load_base

    _write(target, ModelFile(with_known_values(load_base(base), _known(settings)), {}))


@group.command()
def arm(
    target: NewModelOptions,
    urdf: Annotated[str | None, typer.Option(help="URDF file of the robot.")] = None,
    mjcf: Annotated[str | None, typer.Option(help="MJCF file of the robot (MuJoCo's XML), in place of --urdf.")] = None,
    robot: Annotated[str | None, typer.Option(help="Name of a known robot, such as baxter.")] = None,
    joints: JointsOption = None,
    tool: ToolOption = None,
    drive: DriveOption = None,
    wrench: WrenchOption = None,
) -> None:
    """Write the rigid-body model of an arm from a URDF or MJCF; by default the arm is the longest chain of joints."""
    from armdyn.arm.described import with_described_effects
    from armdyn.arm.drives import chosen_drives
    from armdyn.arm.model import arm_model
    from armdyn.arm.wrench.sensor import chosen_sensors
    from armdyn.model_file import ModelFile

    if sum(given is not None for given in (urdf, mjcf, robot)) != 1:
        from urdf import known_robots

        known = ", ".join(known_robots())
        raise InputError(f"an arm needs one of --urdf ROBOT.urdf, --mjcf ROBOT.xml, and --robot with one of {known}")
    made = with_described_effects(arm_model(urdf or mjcf, robot, split_names(joints), tool=tool))
    made = made.with_drives(chosen_drives(drive or (), made.joints)).with_sensors(chosen_sensors(wrench or ()))
    entries = {"robot": robot, "joints": list(made.joints), "tool": tool}
    description = {name: entry for name, entry in entries.items() if entry is not None}
    weightless = [
        f"CHECK: link '{link}' has no <inertial>, so that it weighs nothing in the model, and its true weight will "
        "appear as an effect: write its mass, centre and inertia into the URDF"
        for link in made.arm.links_without_mass
    ]
    _write(target, ModelFile(made, description), (*made.arm.robot.notes, *weightless))


def _known(settings: list[str] | None) -> dict[str, str]:
    """Values of parameters from the option ``--set``, as texts by name."""
    known: dict[str, str] = {}
    for setting in settings or ():
        name, equals, text = setting.partition("=")
        if not equals or not text.strip():
            raise InputError(f'--set {setting}: write it as --set mass="80 g +/- 0.4 g"')
        if name.strip() in known:
            raise InputError(f"--set {setting}: '{name.strip()}' is set twice: give it once")
        known[name.strip()] = text
    return known


def _write(
    target: NewModelOptions, file: "ModelFile", notes: Sequence[str] = (), assumed: Collection[str] = ()
) -> None:
    """Write a model's file, and say which values nobody has stated: `assumed`."""
    from armdyn.model_file import write_model_file

    check_outputs(target.model, target.json_file)
    _check_replaced(target)
    write_model_file(target.model, file)
    path, model, description = target.model, file.model, file.description
    shared = {name: p for name, p in model.parameters.items() if p.scope == "shared"}

    def answer() -> dict[str, Any]:
        parameters = {name: {"value": p.value, "unit": p.unit} for name, p in shared.items()}
        effects = [effect.label for effect in model.effects]
        about = {"schema": "armdyn.model/1", "file": str(path), "effects": effects, "parameters": parameters}
        return {**about, **model.file_entries(path.parent), **description, **({"notes": list(notes)} if notes else {})}

    if write_json_if_file_given(target.json_file, answer):
        what = [f"{name} {p.value:g} {p.unit}{' (assumed)' * (name in assumed)}" for name, p in shared.items()]
        what += [f"joints {', '.join(description['joints'])}"] if "joints" in description else []
        typer.echo(f"{path}: {', '.join([model.base, *what])}")
        for note in notes:
            typer.echo(f"  {note}")
        imported = sorted(Path("runs").glob("*.csv"))  # where an import has written them
        runs = "runs/*.csv" if imported else "RUN..."
        if 1 < len(imported) <= MAX_LISTED_RUNS:
            runs = shell_quoted_command(*imported[:-1], "--held-out", imported[-1]).removeprefix("armdyn ")
        typer.echo(f"next: {shell_quoted_command('repair', path)} {runs} --output repaired.toml --report repair.html")


def _check_replaced(target: NewModelOptions) -> None:
    """Check that an existing file is a model without effects, which a new model may replace."""
    import tomllib

    model = target.model
    if model.is_file() and model.suffix != ".toml":
        raise InputError(f"{model} exists and is not a model file: choose another name")
    if not model.is_file() or target.force:
        return
    try:
        table = tomllib.loads(model.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        table = {"history": True}
    if "base" not in table or table.get("history") or table.get("effects"):
        raise InputError(f"{model} is there already and holds more than a new model: --force writes over it")
    allow_overwrite(model)
