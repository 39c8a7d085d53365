"""The session on the page of the Python interface prints what it shows."""

import doctest
import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_session_prints_what_the_page_shows(tmp_path, monkeypatch, armdyn):
    pytest.importorskip("pandas", reason="the page shows a data frame: pip install 'armdyn[notebook]'")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples/ur5", "examples/ur5")
    logs = [f"examples/ur5/{name}.csv" for name in ("sweep_1", "sweep_2", "pick_and_place")]
    assert armdyn("import", *logs, "--output", "runs", "--guess", "--robot", "ur5")[0] == 0
    assert armdyn("import", *logs, "--output", "runs", "--map", "runs/map.toml")[0] == 0
    (session,) = re.findall(r"```pycon\n(.*?)```", (ROOT / "docs/python.md").read_text("utf-8"), re.DOTALL)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    said = []
    test = doctest.DocTestParser().get_doctest(session, {}, "docs/python.md", None, 0)
    doctest.DocTestRunner(optionflags=flags).run(test, out=said.append)
    assert not said, "".join(said)
