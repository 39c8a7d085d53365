"""The command line, for tests of single commands."""

import sys

import pytest

from pipeline.cli import main


@pytest.fixture
def armdyn(capsys, monkeypatch, tmp_path):
    """Run a command in this process and a folder of its own: exit status, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["armdyn", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        return stop.value.code, *capsys.readouterr()

    return run
