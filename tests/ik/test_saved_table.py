"""Tables on disk: the same when they are right, refused when they are not."""

from dataclasses import fields, replace

import numpy as np
import pytest

import ik
from armdyn.errors import InputError


@pytest.fixture
def saved(table, tmp_path):
    path = tmp_path / "baxter.npz"
    table.save(path)
    return path


def change(path, **arrays) -> None:
    """Write the file again with other arrays in it."""
    with np.load(path) as file:
        content = dict(file)
    np.savez(path, **(content | arrays))


def test_a_saved_table_is_read_back_to_the_last_digit(saved, table, baxter) -> None:
    read = ik.LineTable.load(saved, baxter)
    for item in fields(ik.LineTable):
        if item.name not in ("path", "torque"):
            assert np.array_equal(getattr(read, item.name), getattr(table, item.name)), item.name
    for item in fields(table.torque):
        assert np.array_equal(getattr(read.torque, item.name), getattr(table.torque, item.name)), item.name
    for item in fields(table.line):
        assert np.array_equal(getattr(read.line, item.name), getattr(table.line, item.name)), item.name


def test_a_table_of_other_settings_is_refused(saved, baxter) -> None:
    with pytest.raises(ik.StaleTableError, match="'baxter' have changed since; build it again"):
        ik.LineTable.load(saved, replace(baxter, fingerprint="0" * 64))


def test_a_table_of_another_robot_is_refused(saved, baxter) -> None:
    with pytest.raises(ik.StaleTableError, match="of robot 'baxter', not 'ur5'"):
        ik.LineTable.load(saved, replace(baxter, name="ur5"))


def test_a_table_whose_numbers_were_changed_is_refused(saved, baxter, table) -> None:
    q = table.q.copy()
    q[100, 3] += 1e-6
    change(saved, q=q)
    with pytest.raises(ik.StaleTableError, match="its numbers were changed"):
        ik.LineTable.load(saved, baxter)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_truncated_table_is_refused(saved, baxter, share: float) -> None:
    content = saved.read_bytes()
    saved.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ik.StaleTableError, match="not an IK table, or damaged"):
        ik.LineTable.load(saved, baxter)


@pytest.mark.parametrize("content", [b"hello", b"PK\x03\x04 nonsense"])
def test_another_kind_of_file_is_refused(tmp_path, baxter, content: bytes) -> None:
    path = tmp_path / "table.npz"
    path.write_bytes(content)
    with pytest.raises(ik.StaleTableError, match="not an IK table, or damaged"):
        ik.LineTable.load(path, baxter)


def test_a_table_without_an_array_is_refused(saved, baxter) -> None:
    with np.load(saved) as file:
        content = {name: file[name] for name in file.files if name != "jacobian"}
    np.savez(saved, **content)
    with pytest.raises(ik.StaleTableError, match="damaged"):
        ik.LineTable.load(saved, baxter)


def test_a_missing_table_is_bad_input_that_says_how_to_get_one(tmp_path, baxter) -> None:
    with pytest.raises(InputError, match="there is no such table; build it again with 'armdyn ik build'"):
        ik.LineTable.load(tmp_path / "none.npz", baxter)


def test_writing_to_a_missing_directory_is_bad_input(table, tmp_path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        table.save(tmp_path / "nowhere" / "table.npz")


def test_the_default_table_is_built_once_and_again_when_damaged(baxter, table, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("ARMDYN_CACHE", str(tmp_path))
    stages: list[str] = []
    built = ik.default_table(baxter, progress=stages.append)
    assert stages
    assert np.abs(built.q - table.q).max() < 1e-9
    stages.clear()
    ik.default_table(baxter, progress=stages.append)
    assert not stages
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:5000])
    assert ik.default_table(baxter, progress=stages.append).joint_margin == pytest.approx(table.joint_margin)
    assert stages
