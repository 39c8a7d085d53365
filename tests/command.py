"""The command line in this process."""

import contextlib
import io
import os
import sys
from unittest import mock

import pytest

from pipeline.cli import main


def called(*arguments):
    """Exit status of a command, what it printed, what it complained of."""
    out, err = io.StringIO(), io.StringIO()
    words = mock.patch.object(sys, "argv", ["armdyn", *map(str, arguments)])
    environment = mock.patch.dict(os.environ)  # which a command changes
    redirected = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
    with words, environment, redirected[0], redirected[1], pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, out.getvalue(), err.getvalue()


def refused(*arguments):
    """The one line that a command says of bad input."""
    status, out, err = called(*arguments)
    assert (status, out, err.count("\n")) == (2, "", 1), (status, out, err)
    return err
