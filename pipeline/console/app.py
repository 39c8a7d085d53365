"""Build the command line from the commands, run a command, and convert its errors to one line and an exit status."""

import errno
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import nullcontext, suppress
from functools import wraps
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from armdyn import __version__
from armdyn.errors import ArmdynError, InputError, TaskFailedError
from armdyn.read_files import refuse_overwriting_inputs
from armdyn.user_code import TRUST_OPTION, trusting_code
from pipeline import commands
from pipeline.console.description_warnings import collected_warnings, collecting_warnings
from pipeline.console.groups import with_flattened_options
from pipeline.console.streams import non_raising_streams, report_unexpected_error
from pipeline.interrupts import Interrupt, SignalHandler
from urdf.bounds import MAX_INPUT_MAGNITUDE, has_plausible_magnitude, printable_excerpt


def command_modules() -> dict[str, str]:
    """Module of every command in `pipeline.commands`, by the command's name; ``import`` is in module ``import_``."""
    return {module.name.removesuffix("_"): module.name for module in iter_modules(commands.__path__)}


def build_application(files: Iterable[str]) -> typer.Typer:
    """Build the command line from some modules of `pipeline.commands`; other commands are not imported.

    Each module defines a function of its own name, or `group`, a Typer application with several subcommands. Its
    constant `HELP_PANEL` is the heading under which `armdyn --help` lists the command.
    """
    app = typer.Typer(
        name="armdyn",
        help="Find out what the model of a robot lacks, add it, and use the repaired model.",
        no_args_is_help=True,
        rich_markup_mode="markdown",  # a unit in square brackets is text, not a style
        pretty_exceptions_enable=False,
    )
    app.callback()(_common)
    for file in files:
        module = import_module(f"{commands.__name__}.{file}")
        place = {"name": file.removesuffix("_"), "rich_help_panel": module.HELP_PANEL}
        if not hasattr(module, "group"):
            app.command(**place)(_checked(with_flattened_options(getattr(module, file))))
            continue
        for command in module.group.registered_commands:
            command.callback = _checked(with_flattened_options(command.callback))
        app.add_typer(module.group, **place)
    return app


def _version(asked: bool) -> None:
    if asked:
        print(f"armdyn {__version__}")
        raise typer.Exit


def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and stop.", is_eager=True, callback=_version)
    ] = False,
    trust_code: Annotated[
        bool,
        typer.Option(
            TRUST_OPTION,
            help="With any command: run Python files outside its folder that a model or batch names, from now on.",
        ),
    ] = False,
) -> None:
    del version, trust_code


def run(interrupts: SignalHandler) -> int:
    """Run the command that the arguments of this process name.

    Args:
        interrupts: handler of signals such as Ctrl-C.

    Returns:
        The exit status: 0 done, 1 the answer is no or the task failed, 2 bad input, 3 an error of armdyn itself,
        128 + n if signal n ended the command.
    """
    with refuse_overwriting_inputs(), non_raising_streams() as problem_of_output, collecting_warnings():
        try:
            status = _run_command(interrupts)
            for sentence in collected_warnings():
                _say(f"CHECK: {sentence}", status)
        except BaseException as error:
            status = _say_why(error, interrupts)
        problem = problem_of_output()
        if problem is not None and status in (0, 1):
            status = _say(f"cannot write to standard output: {problem}; choose another place", 2)
    return status


def _run_command(interrupts: SignalHandler) -> int:
    known = command_modules()
    trusted = TRUST_OPTION in sys.argv[1:]
    sys.argv[1:] = [word for word in sys.argv[1:] if word != TRUST_OPTION]
    asked = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
    app = build_application([known[asked]] if asked in known else known.values())
    interrupts.check()
    with trusting_code() if trusted else nullcontext():
        status = app(standalone_mode=False)
    interrupts.check(ended=True)
    return status if isinstance(status, int) else 0


def _checked(command: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a command so that it refuses numbers such as ``nan``, ``1e300`` and ``1_000`` in its options."""

    @wraps(command)
    def checked(*arguments: Any, **options: Any) -> Any:
        for name, value in options.items():
            for each in value if isinstance(value, list | tuple) else [value]:
                if isinstance(each, Path):
                    _check_leads_somewhere(each)
                if isinstance(each, int | float) and not (has_plausible_magnitude(each) and _is_written_plainly(each)):
                    option = f"--{name.replace('_', '-')}"
                    raise InputError(
                        f"{option} {each:g}: give a number between {-MAX_INPUT_MAGNITUDE:g} "
                        f"and {MAX_INPUT_MAGNITUDE:g}, such as 1000"
                    )
        return command(*arguments, **options)

    return checked


def _check_leads_somewhere(path: Path) -> None:
    """Refuse circular symbolic links and impossible file names."""
    try:
        path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        why = "its links lead in a circle" if isinstance(error, RuntimeError) else f"no file has such a name ({error})"
        raise InputError(f"{printable_excerpt(str(path))}: {why}: give another file") from error


def _is_written_plainly(value: float) -> bool:
    for text in (word.rpartition("=")[2] for word in sys.argv[1:] if "_" in word):
        with suppress(ValueError):
            if float(text) == value:
                return False
    return True


def _say_why(error: BaseException, interrupts: SignalHandler) -> int:
    if interrupts.received is not None and not isinstance(error, Interrupt):
        error = Interrupt(interrupts.received)  # libraries turn an interruption into errors of their own
    if isinstance(error, Interrupt):
        return _say(str(error), 128 + error.number)
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return _say("interrupted", 130)
    if isinstance(error, TyperException):
        usage = _usage(error)
        if not error.format_message():  # a group of commands without a command, whose help was shown
            return _say(f"name a command{usage}", 2)
        return _say((error.format_message().rstrip(".?") if usage else error.format_message()) + usage, 2)
    if isinstance(error, TaskFailedError):
        return _say(str(error), 1)
    if isinstance(error, ArmdynError) or _is_urdf_error(error):
        return _say(str(error), 2)
    # Of a temporary file; without a file's name also ENOENT, which `tempfile` raises where no directory takes a file.
    if isinstance(error, OSError) and (
        error.errno in FULL_DISK_ERRORS or (error.errno == errno.ENOENT and error.filename is None)
    ):
        return _say(f"nothing more can be written: {error.strerror}: make room, or choose another place", 2)
    if isinstance(error, OSError) and error.filename is not None:  # a file name is too long, a disk is gone
        return _say(f"{printable_excerpt(str(error.filename))}: {error.strerror}: choose another file or place", 2)
    return _say(report_unexpected_error(error), 3)


def _usage(error: TyperException) -> str:
    """What to type instead, for a mistake in arguments and options; empty where that is unknown."""
    context = getattr(error, "ctx", None)
    if context is None or error.format_message().startswith("Invalid value"):
        return ""
    command = " ".join(["armdyn", *context.command_path.removeprefix(context.find_root().command_path).split()])
    subcommands = [name for name, each in getattr(context.command, "commands", {}).items() if not each.hidden]
    if subcommands:
        return f"; '{command} --help' lists all" if command == "armdyn" else f"; choose from {', '.join(subcommands)}"
    words = command
    for each in context.command.params:
        value = each.metavar or ("FILE" if each.name == "output" else each.name.upper())
        if each.param_type_name == "argument":
            words += f" {value.strip('{}')}"
        elif each.required:
            words += f" {each.opts[0]} {value}"
    more = f"'{command} --help' lists its options"
    return f"; {more}" if words == command else f"; type '{words}', {more}"


def _is_urdf_error(error: BaseException) -> bool:
    """Whether an error is a `urdf.UrdfError`; found without importing `urdf`, which takes half a second."""
    module = sys.modules.get("urdf.robot")
    return module is not None and isinstance(error, module.UrdfError)


FULL_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""Numbers of the system's errors where there is no room to write, or nothing on the disk may be written."""
MAX_WORD_CHARACTERS = 300
"""Largest number of characters of a word in an error message; longer words are cut."""


def _say(message: str, status: int) -> int:
    words = (word if len(word) <= MAX_WORD_CHARACTERS else f"{word[:60]}..." for word in message.split())
    line = f"armdyn: {' '.join(words)}{os.linesep}"
    if sys.stderr is not None:
        sys.stderr.write(line)
        sys.stderr.flush()
    return status
