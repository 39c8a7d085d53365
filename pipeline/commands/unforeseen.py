"""What nobody has foreseen: one line for the user, and a file with everything that whoever mends it needs."""

import platform
import shlex
import sys
import tempfile
import traceback
from datetime import datetime
from importlib import metadata

PACKAGES = ("armdyn", "casadi", "pin", "mujoco", "numpy", "scipy")


def report_unforeseen(error: BaseException) -> str:
    """Write the report; a sentence that says what was raised and where the report is."""
    what = f"{type(error).__name__}{': ' if str(error) else ''}{' '.join(str(error).split())[:200]}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="armdyn-report-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(_report(error))
        place = f"please send {file.name}"
    except OSError:  # a full disk must not hide what happened
        frames = traceback.extract_tb(error.__traceback__)
        place = f"it came from {frames[-1].filename}, line {frames[-1].lineno}" if frames else "nothing more is known"
    return f"{what}: this was not foreseen, it is a mistake of armdyn and not yours; {place}"


def _report(error: BaseException) -> str:
    versions = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return "\n".join(
        (
            f"command: {shlex.join(['armdyn', *sys.argv[1:]])}",
            f"time: {datetime.now().astimezone().isoformat(timespec='seconds')}",
            f"system: {platform.platform()}, Python {platform.python_version()}",
            f"versions: {versions}",
            "",
            *traceback.format_exception(error),
        )
    )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
