"""Without NiceGUI the command says how to install it."""

import sys


def test_the_missing_package_is_one_line(armdyn, monkeypatch):
    for name in [
        name for name in sys.modules if name.partition(".")[0] == "nicegui" or name.startswith("pipeline.work")
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    status, out, errors = armdyn("workbench", "--no-browser")
    assert (status, out) == (2, "")
    assert errors == ("armdyn: the workbench needs the package 'nicegui': run pip install 'armdyn[workbench]'\n")
