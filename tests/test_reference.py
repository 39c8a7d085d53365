"""The reference in the documentation has every name that a user sees."""

import re
from importlib import import_module
from inspect import ismodule
from pathlib import Path

import pytest

import armdyn
import ik
import urdf

PAGE = (Path(__file__).parents[1] / "docs" / "reference.md").read_text()


def documented():
    """Full names: of objects, and of the members that are listed of modules."""
    for entry in re.split(r"^::: ", PAGE, flags=re.MULTILINE)[1:]:
        name = entry.split("\n", 1)[0].strip()
        yield name
        listed = re.search(r"members: \[(.*?)\]", entry)
        yield from (f"{name}.{member.strip()}" for member in (listed[1].split(",") if listed else ()))


@pytest.mark.parametrize("package", [armdyn, ik, urdf])
def test_the_reference_has_everything_that_dir_shows(package):
    shown = {name: getattr(package, name) for name in dir(package)}
    for module in [module for module in shown.values() if ismodule(module)]:
        shown |= {name: getattr(module, name) for name in module.__all__}
    names: dict[str, list[str]] = {}
    for found in documented():
        names.setdefault(found.rpartition(".")[2], []).append(found)
    assert {name for name, found in shown.items() if not ismodule(found)} <= set(names)
    for name in set(shown) & set(names):
        places = [found.rpartition(".") for found in names[name]]  # 'load' is in several packages
        assert any(getattr(import_module(module), attribute, None) is shown[name] for module, _, attribute in places)
