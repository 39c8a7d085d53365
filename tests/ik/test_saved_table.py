"""Tables on disk: the same when they are right, refused when they are not."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

import ik
from armdyn.errors import InputError


@pytest.fixture
def saved(table, tmp_path):
    path = tmp_path / "baxter.npz"
    table.save(path)
    return path


def test_a_saved_table_is_read_back_to_the_last_digit(saved, table, baxter) -> None:
    read = ik.LineTable.load(saved, baxter)
    for one, other in (
        (read, table),
        (read.torque, table.torque),
        (read.line, table.line),
        (read.limits, table.limits),
    ):
        for item in fields(other):
            if not is_dataclass(getattr(other, item.name)):
                assert np.array_equal(getattr(one, item.name), getattr(other, item.name)), item.name


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"fingerprint": "0" * 64}, "'baxter' have changed since; build it again"),
        ({"name": "ur5"}, "it is of robot 'baxter', not 'ur5'"),
    ],
)
def test_a_table_of_another_robot_or_other_settings_is_refused(saved, baxter, changed, sentence) -> None:
    with pytest.raises(ik.StaleTableError, match=sentence):
        ik.LineTable.load(saved, replace(baxter, **changed))


def test_a_table_whose_numbers_were_changed_or_taken_out_is_refused(saved, baxter, table) -> None:
    with np.load(saved) as file:
        content = dict(file)
    q = table.q.copy()
    q[100, 3] += 1e-6
    np.savez(saved, **(content | {"q": q}))
    with pytest.raises(ik.StaleTableError, match="its numbers were changed"):
        ik.LineTable.load(saved, baxter)
    del content["jacobian"]
    np.savez(saved, **content)
    with pytest.raises(ik.StaleTableError, match="damaged"):
        ik.LineTable.load(saved, baxter)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, None])
def test_a_truncated_table_or_another_kind_of_file_is_refused(saved, baxter, share: float | None) -> None:
    content = saved.read_bytes()
    saved.write_bytes(b"PK\x03\x04 nonsense" if share is None else content[: int(share * len(content))])
    with pytest.raises(ik.StaleTableError, match="not an IK table, or damaged"):
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
