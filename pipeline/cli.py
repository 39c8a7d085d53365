"""The command `armdyn`: collects the commands and turns errors into one line and an exit status."""

import sys
from importlib import import_module

import typer
from typer.exceptions import TyperException

from armdyn.errors import ArmdynError, TaskFailedError
from urdf.robot import UrdfError

app = typer.Typer(
    name="armdyn",
    help="Learn what a robot arm handles, use it, and find out where the model is wrong.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

COMMANDS = ("trial", "models", "identify", "ik", "arm", "check", "loadcell", "ros")
"""Modules of `pipeline.commands`, in the order in which `armdyn --help` lists their commands."""


def _register() -> None:
    for name in COMMANDS:
        import_module(f"pipeline.commands.{name}").register(app)


def main() -> None:
    """Run a command; exit status 0 done, 1 the answer is no, 2 bad input."""
    _register()
    try:
        status = app(standalone_mode=False)
    except TyperException as error:
        sys.exit(_say(error.format_message(), 2))
    except TaskFailedError as error:
        sys.exit(_say(str(error), 1))
    except (ArmdynError, UrdfError) as error:
        sys.exit(_say(str(error), 2))
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(_say("interrupted", 130))
    sys.exit(status if isinstance(status, int) else 0)


def _say(message: str, status: int) -> int:
    print(f"armdyn: {' '.join(message.split())}", file=sys.stderr)
    return status
