"""Limits that guard an arm come from files that nobody checks: settings, tables, volumes."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import ik
import urdf
from armdyn.errors import InputError
from ik import table_archive
from ik.table import ARRAY_AXES
from ik.table_archive import arrays_digest, read_arrays, write_arrays
from ik.volume import TargetGrid, VolumeTable, build_volume

SETTINGS = Path(urdf.__file__).parent / "robots" / "baxter.toml"
ACCELERATION, JERK = "acceleration = [20.0", "jerk = [1000.0"
WRONG = {
    "no acceleration at all": (ACCELERATION, "acceleration = [0.0"),
    "negative": (ACCELERATION, "acceleration = [-20.0"), "nan": (ACCELERATION, "acceleration = [nan"),
    "infinite": (JERK, "jerk = [inf"), "enormous": (JERK, "jerk = [1e300"),
    "400 digits": (JERK, "jerk = [1" + 400 * "0"), "text": (JERK, 'jerk = ["fast"'),
    "one too few": (JERK + ", ", "jerk = ["), "misspelt": ("acceleration", "acceleratoin"),
    "misspelt table": ("[limits]", "[limts]"), "home outside": ("home = [0.12", "home = [12.0"),
    "home nan": ("home = [0.12", "home = [nan"),
    "joints no list": ('joints = ["right_s0", ', 'joints = 3 # ["right_s0", '),
    "joint twice": ('joints = ["right_s0", ', 'joints = ["right_s0", "right_s0", '),
    "core outside": ("core = [-0.20", "core = [-3.0"), "no speed": ("core_speed = 1.005", "core_speed = 0"),
    "no direction": ("direction = [0.0, 1.0, 0.0]", "direction = [0, 0, 0]"),
    "tool in millimetres": ("offset = [0.0, 0.0, 0.03]", "offset = [0, 0, 300]"),
    "spring on no joint": ('joint = "right_s1"', 'joint = "nose"'),
    "spring half on": ("enabled = false", 'enabled = "no"'),
    "frame on no link": ('parent = "right_gripper"', 'parent = "nowhere"'),
    "nested": ('name = "baxter"', "name = " + 3000 * "[" + 3000 * "]"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new"), WRONG.values(), ids=WRONG)
def test_settings_that_would_guard_nothing_are_refused_in_one_line(tmp_path, old, new, complains) -> None:
    text = SETTINGS.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with complains(urdf.UrdfError):
        urdf.load(path)


def test_settings_in_latin_1_are_refused(tmp_path, complains) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(SETTINGS.read_bytes() + "# é".encode("latin-1"))
    with complains(urdf.UrdfError):
        urdf.load(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0, 1e9])
@pytest.mark.parametrize("name", ["velocity", "acceleration", "jerk", "effort"])
def test_no_limit_guards_nothing(name, bad, complains) -> None:
    one = {key: np.ones(2) for key in ("upper", "velocity", "acceleration", "jerk", "effort")}
    with complains(urdf.UrdfError):
        urdf.Limits(lower=-np.ones(2), **{**one, name: np.array([1.0, bad])})


@pytest.fixture(scope="module")
def saved(baxter, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("table") / "baxter.npz"
    ik.default_table(baxter).save(path)
    return path


CHANGES = {
    "larger": lambda a: {"velocity": 100 * a["velocity"]},
    "upside down": lambda a: {"lower": a["upper"], "upper": a["lower"]},
    "nan": lambda a: {"q": np.where(a["q"] == a["q"][7, 3], np.nan, a["q"])},
    "backwards": lambda a: {"s": a["s"][::-1].copy()},
    "uneven": lambda a: {"s": a["s"] + 1e-3 * (np.arange(len(a["s"])) == 5)},
    "slow": lambda a: {"dq_ds": 0.01 * a["dq_ds"]},
    "slow everywhere": lambda a: {
        "dq_ds": 0.01 * a["dq_ds"],
        "d2q_ds2": 0.01 * a["d2q_ds2"],
        "q": 0.99 * a["q"][:1] + 0.01 * a["q"],
    },
    "elsewhere": lambda a: {"q": a["q"] + 0.1},
    "shorter": lambda a: {"q": a["q"][:-1]},
    "integers": lambda a: {"effort": a["effort"].astype(np.int64)},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_table_that_cannot_be_right_is_refused_whatever_its_digest(
    saved, baxter, tmp_path, change, complains
) -> None:
    about, arrays = read_arrays(saved, ARRAY_AXES)
    about.pop("format")
    write_arrays(tmp_path / "table.npz", about, {**arrays, **change(arrays)})
    with complains(ik.StaleTableError):
        ik.PathTable.load(tmp_path / "table.npz", baxter)


def test_a_table_of_another_path_is_refused(saved, tmp_path, complains) -> None:
    about, arrays = read_arrays(saved, ARRAY_AXES)
    about["path"]["direction"] = [1.0, 0.0, 0.0]
    write_arrays(tmp_path / "table.npz", {key: value for key, value in about.items() if key != "format"}, arrays)
    with complains(ik.StaleTableError):
        ik.PathTable.load(tmp_path / "table.npz")


def test_what_a_table_is_about_is_part_of_its_digest() -> None:
    arrays = {"q": np.zeros((2, 3))}
    assert arrays_digest("a", arrays) != arrays_digest("b", arrays)
    assert arrays_digest("a", arrays) != arrays_digest("a", {"q": np.zeros((3, 2))})


def test_a_table_that_expands_without_end_is_refused(tmp_path, monkeypatch, complains) -> None:
    monkeypatch.setattr(table_archive, "MAX_IK_TABLE_ARRAY_BYTES", 2**20)
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, s=np.zeros(2**18), about=np.array("{}"))
    with complains(ik.StaleTableError):
        ik.PathTable.load(path)


@pytest.fixture(scope="module")
def volume(baxter, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("volume") / "small.zarr"
    grid = TargetGrid(np.array([0.7, -0.4, -0.2]), np.array([0.8, -0.3, -0.1]), (4, 4, 4), baxter.line.rotation[None])
    build_volume(baxter, grid, path)
    return path


def files(volume: Path, array: str) -> list[Path]:
    return sorted(path for path in (volume / array).rglob("*") if path.is_file())


@pytest.mark.parametrize("array", ["q", "status", "skeleton", "digests"])
def test_a_volume_with_one_flipped_bit_is_refused(volume, baxter, tmp_path, array, complains) -> None:
    chunks = [path for path in files(volume, array) if path.name != "zarr.json"]
    for place in (0, 5, -1):
        copy = tmp_path / f"copy{place}"
        shutil.copytree(volume, copy)
        chunk = copy / chunks[0].relative_to(volume)
        data = bytearray(chunk.read_bytes())
        data[place] ^= 1
        chunk.write_bytes(bytes(data))
        with complains(ik.StaleTableError):
            VolumeTable.open(copy, baxter)


@pytest.mark.parametrize("array", ["q", "status", "skeleton", "digests"])
@pytest.mark.parametrize("all_of_it", [True, False])
def test_a_volume_without_an_array_or_its_numbers_is_refused_or_built_on(
    volume, baxter, tmp_path, array, all_of_it, complains
):
    copy = tmp_path / "copy"
    shutil.copytree(volume, copy)
    for path in files(copy, array):
        if all_of_it or path.name != "zarr.json":
            path.unlink()
    if array == "digests" and not all_of_it:  # nothing is lost: it counts as not done yet
        assert len(VolumeTable.open(copy, baxter).unfinished_blocks()) == 1
        return
    with complains(ik.StaleTableError):
        VolumeTable.open(copy, baxter)


def test_a_grid_that_no_disk_holds_is_refused(complains) -> None:
    rotation = np.eye(3)[None]
    for low, high, counts in (
        ((0, 0, 0), (1, 1, 1), (10**6, 10**6, 10**6)),
        ((0, 0, np.nan), (1, 1, 1), (3, 3, 3)),
        ((0, 0, 0), (1, 1, 1e9), (3, 3, 3)),
    ):
        with complains(InputError):
            TargetGrid(np.array(low, dtype=float), np.array(high, dtype=float), counts, rotation)
