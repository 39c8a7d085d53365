"""Compiled code comes from a folder of ours alone, whole, or is made anew; else the virtual machine computes."""

import os
import shutil
import stat
import tempfile
from pathlib import Path

import casadi as ca
import pytest

from armdyn import cache, codegen
from armdyn.cache import cache_directory, entry_name, private_directory
from armdyn.codegen import compile_functions

pytestmark = pytest.mark.skipif(codegen.find_compiler() is None, reason="needs a C compiler")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    place.mkdir(mode=0o700)
    monkeypatch.setenv("ARMDYN_CACHE", str(place))
    return place


def tripled(name="triple", factor=3):
    x = ca.SX.sym("x")
    return compile_functions(name, {"f": ca.Function("f", [x], [factor * x])})["f"]


def is_machine_code(function):
    return "External" in function.class_name()


def other_code(path):
    """A library that gives wrong numbers."""
    function = tripled("other", factor=-7)
    assert is_machine_code(function)
    (wrong,) = path.glob("other-*.so")
    return wrong.read_bytes()


def test_a_library_is_made_once_and_then_kept(folder, monkeypatch):
    assert float(tripled()(2)) == 6
    (library,) = folder.iterdir()
    made = library.stat().st_mtime_ns
    monkeypatch.setattr(codegen, "_compile", lambda *_: pytest.fail("made again"))
    function = tripled()
    assert is_machine_code(function)
    assert float(function(2)) == 6
    assert library.stat().st_mtime_ns == made


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "replaced"])
def test_a_damaged_library_is_made_anew(folder, damage):
    tripled()
    (library,) = folder.iterdir()
    name, content = library.name, library.read_bytes()
    wrong = {
        "cut": content[: len(content) // 2],
        "flipped": content[:-100] + bytes([content[-100] ^ 255]) + content[-99:],
        "empty": b"",
        "replaced": other_code(folder),
    }[damage]
    library.unlink()  # what this process has loaded stays as it is
    library.write_bytes(wrong)
    library.chmod(0o700)
    function = tripled()
    assert is_machine_code(function)
    assert float(function(2)) == 6
    assert (folder / name).read_bytes() == content


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o775])
def test_a_folder_that_others_can_write_to_is_not_used(folder, mode):
    folder.chmod(mode)
    function = tripled()
    assert not is_machine_code(function)
    assert float(function(2)) == 6
    assert list(folder.iterdir()) == []
    assert stat.S_IMODE(folder.stat().st_mode) == mode
    assert cache_directory() != folder
    assert stat.S_IMODE(cache_directory().stat().st_mode) == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to others")
def test_a_folder_or_library_of_another_user_is_not_used(folder):
    tripled()
    (library,) = folder.iterdir()
    os.chown(library, 12345, 12345)
    assert is_machine_code(tripled())
    assert library.stat().st_uid == os.geteuid()  # made anew
    os.chown(folder, 12345, 12345)
    assert private_directory() is None
    assert not is_machine_code(tripled())


def test_a_link_in_the_cache_is_not_followed(folder, tmp_path):
    tripled()
    (library,) = folder.iterdir()
    elsewhere = tmp_path / "elsewhere.so"
    shutil.move(library, elsewhere)
    library.symlink_to(elsewhere)
    assert float(tripled()(2)) == 6
    assert not library.is_symlink()


def test_the_usual_folder_is_closed_to_others(tmp_path, monkeypatch):
    monkeypatch.delenv("ARMDYN_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "armdyn").mkdir()
    (tmp_path / "armdyn").chmod(0o777)
    assert private_directory() == tmp_path / "armdyn"
    assert stat.S_IMODE((tmp_path / "armdyn").stat().st_mode) == 0o755


@pytest.mark.parametrize("place", ["file", "under a file", "circle", "device"])
def test_without_a_place_the_virtual_machine_computes(tmp_path, monkeypatch, place):
    (tmp_path / "file").write_text("")
    (tmp_path / "circle").symlink_to("circle")
    root = {"under a file": tmp_path / "file" / "cache", "device": Path("/dev/null/cache")}.get(place, tmp_path / place)
    monkeypatch.setenv("ARMDYN_CACHE", str(root))
    function = tripled()
    assert not is_machine_code(function)
    assert float(function(2)) == 6
    assert cache_directory().is_dir()


def test_without_a_home_the_virtual_machine_computes(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    for name in ("ARMDYN_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(cache.Path, "home", homeless)
    assert not is_machine_code(tripled())


def test_on_a_full_disk_the_virtual_machine_computes(folder, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    assert float(tripled()(2)) == 6
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("name", ["../../evil", "/etc/evil", "a b\0c", "ü" * 300, ""])
def test_a_name_never_becomes_a_path(folder, name):
    assert float(tripled(name)(2)) == 6
    (library,) = folder.iterdir()
    assert library.parent == folder
    assert "/" not in entry_name(name)
    assert "." not in entry_name(name)
    assert [p.name for p in folder.parent.iterdir()] == ["cache"]
