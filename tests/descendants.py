"""Processes that a process has started, and those have started, also when it is gone; what they may be busy with."""

import os
import re
import signal
import subprocess
import sys
import time
import uuid
from contextlib import contextmanager
from pathlib import Path

import pytest

PROC = Path("/proc")
linux = pytest.mark.skipif(not (PROC / "self/environ").exists(), reason="finds processes as Linux shows them")
PATIENCE = 60.0


def of_mark(mark):
    """Numbers of all processes that have this text in their environment, which children inherit."""
    found = []
    for path in PROC.glob("[0-9]*"):
        try:
            if mark.encode() in (path / "environ").read_bytes():
                found.append(int(path.name))
        except OSError:  # it has ended meanwhile
            continue
    return found


def becomes(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


@contextmanager
def marked(*command, **named):
    """A process, and the mark of it and of all that it starts."""
    mark, tests = uuid.uuid4().hex, str(Path(__file__).parent)
    path = os.pathsep.join([tests, *filter(None, sys.path)])
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path, "MARK": mark}, **named
    ) as process:
        try:
            yield process, mark
        finally:
            process.kill()
            for left in of_mark(mark):
                os.kill(left, signal.SIGKILL)


def waits(_):
    signal.pause()


def computes(_):
    """Never gives Python's lock away."""
    re.match(r"(a+)+$", "a" * 60 + "b")
