from datetime import UTC, datetime

import pytest

from armdyn.errors import InputError
from pipeline.loadcell.calibration import Calibration, default_path
from pipeline.loadcell.fit import parse_weights

CALIBRATION = Calibration(
    84213.5, 2.5, -5.6e-6, 6e-11, 2.2e-4, datetime(2026, 3, 2, 10, 15, tzinfo=UTC), 'calibrate COM3: "0 g", ü'
)


def test_a_stored_calibration_comes_back_to_the_last_digit(tmp_path):
    path = tmp_path / "new folder" / "loadcell.toml"
    CALIBRATION.save(path)
    assert Calibration.load(path) == CALIBRATION
    assert [file.name for file in path.parent.iterdir()] == ["loadcell.toml"]


def test_force_is_scale_times_counts_above_the_offset():
    assert CALIBRATION.force(84213.5) == 0.0
    assert CALIBRATION.force(84213.5 - 100_000) == pytest.approx(0.56)
    assert CALIBRATION.counts(0.56) == pytest.approx(84213.5 - 100_000)


def test_the_file_of_the_document_is_a_calibration(tmp_path):
    import re
    from pathlib import Path

    document = (Path(__file__).parents[3] / "docs" / "loadcell.md").read_text()
    (tmp_path / "a.toml").write_text(re.search(r"```toml\n(.*?)```", document, re.DOTALL).group(1))
    assert Calibration.load(tmp_path / "a.toml").scale == 5.60005e-06


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("84213.5", "nan"),
        ("84213.5", "1e9"),
        ("84213.5", '"84213.5"'),
        ("84213.5", "true"),
        ("-5.6e-06", "0.0"),
        ("-5.6e-06", "inf"),
        ("0.00022", "0.0"),
        ("0.00022", "-1.0"),
        ("N/count", "g/count"),
        ("scale", "slope"),
        ("offset =", "offset = 3 #"),
        ("2026-03-02T10:15:00Z", "2026-03-02"),
        ("2026-03-02T10:15:00Z", '"yesterday"'),
        ("source = ", "source = 3 # "),
        ("{", ""),
    ],
)
def test_a_calibration_that_cannot_be_used_says_so_in_one_line(tmp_path, old, new):
    path = tmp_path / "loadcell.toml"
    CALIBRATION.save(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match="armdyn loadcell calibrate PORT") as caught:
        Calibration.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00", b"folder"])
def test_a_missing_or_foreign_file_says_what_to_run(tmp_path, content):
    path = tmp_path / "loadcell.toml"
    if content == b"folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="armdyn loadcell calibrate PORT"):
        Calibration.load(path)


def test_a_calibration_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="choose another place"):
        CALIBRATION.save(tmp_path / "file" / "loadcell.toml")
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_the_calibration_is_among_the_users_settings(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert default_path() == tmp_path / "armdyn" / "loadcell.toml"


def test_weights_are_masses_or_forces():
    weights = parse_weights("0 g, 100 g +/- 0.1 g, 0.2 kg, 3 N", 9.81)
    assert [weight.force for weight in weights] == pytest.approx([0.0, 0.981, 1.962, 3.0])
    assert [weight.force_std for weight in weights] == pytest.approx([0.0, 0.000981, 0.0, 0.0])
    assert [weight.text for weight in weights] == ["0 g", "100 g +/- 0.1 g", "0.2 kg", "3 N"]


def test_the_empty_cell_comes_first_even_if_not_listed():
    assert [weight.text for weight in parse_weights("100 g, 200 g", 9.81)] == ["0 g", "100 g", "200 g"]


@pytest.mark.parametrize(
    "text", ["", ",", "0 g", "0 g, 0 N", "100", "0 g, -100 g", "0 g, 2 s", "0 g, heavy", "0 g; 100 g"]
)
def test_nonsense_weights_are_refused_in_one_line(text):
    with pytest.raises(InputError, match="--weights") as caught:
        parse_weights(text, 9.81)
    assert "\n" not in str(caught.value)
