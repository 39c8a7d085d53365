"""A guess never ends without a file to edit: what is not known is asked, column by column."""

import re

import numpy as np


def table(folder, head, columns=3):
    rows = (",".join(f"{np.sin(i / 30 + k):.5f}" if k else f"{i / 50}" for k in range(columns)) for i in range(300))
    (folder / "a.csv").write_text(head + "\n" + "\n".join(rows) + "\n")


def test_columns_that_nobody_can_guess_are_asked_and_the_filled_in_file_is_imported(armdyn, tmp_path):
    table(tmp_path, "stamp,foo,bar")
    status, _, err = armdyn("import", "a.csv", "--output", "runs", "--guess")
    assert (status, err.count("\n")) == (2, 1)
    again = re.search(r"then: armdyn (.*)", err)[1].split()
    text = (tmp_path / "runs" / "map.toml").read_text()
    assert all(f'# {name} = {{ channel = "WHICH"' in text for name in ('"foo"', '"bar"', '"stamp"'))
    assert "q.JOINT [rad]" in text
    assert "from -1 to 1" in text
    text = text.replace('# time = { column = "WHICH"', 'time = { column = "stamp"')
    text = text.replace('# "foo" = { channel = "WHICH", unit = "WHICH"', '"foo" = { channel = "q.j", unit = "rad"')
    (tmp_path / "runs" / "map.toml").write_text(text)
    assert armdyn(*again)[0] == 0
    assert "q.j [rad]" in (tmp_path / "runs" / "a.csv").read_text()


def test_columns_beside_those_that_are_guessed_are_asked_too(armdyn, tmp_path):
    table(tmp_path, "time [s],q.j1 [rad],foo")
    assert armdyn("import", "a.csv", "--output", "runs", "--guess")[0] == 0
    text = (tmp_path / "runs" / "map.toml").read_text()
    assert '# "foo" = { channel = "WHICH"' in text
    assert not re.search('^# "q.j1', text, re.MULTILINE)


def test_a_process_is_guessed_by_the_units_in_its_headers(armdyn, tmp_path):
    table(tmp_path, "minutes,heater_W,thermocouple_C,pump (V),valve_pct,recipe", columns=6)
    status, _, _ = armdyn("import", "a.csv", "--output", "runs", "--guess")
    text = (tmp_path / "runs" / "map.toml").read_text()
    assert status == 0
    assert 'time = { column = "minutes", unit = "min" }' in text
    for header, channel, unit in (
        ("heater_W", "heater", "W"), ("thermocouple_C", "thermocouple", "degC"), ("pump", "pump", "V"),
        ("valve_pct", "valve", "percent"),
    ):  # fmt: skip
        assert f'"{header}" = {{ channel = "extra.{channel}", unit = "{unit}" }}' in text
    assert '# "recipe" = { channel = "WHICH"' in text
    assert armdyn("import", "a.csv", "--output", "runs", "--map", "runs/map.toml")[0] == 0
    assert "extra.heater [W]" in (tmp_path / "runs" / "a.csv").read_text()


def test_the_time_of_a_process_without_a_unit_is_in_seconds_and_is_asked(armdyn, tmp_path):
    rows = "".join(f"{k},{np.sin(k / 9):.4f}\n" for k in range(100))
    (tmp_path / "a.csv").write_text("t,level (cm)\n" + rows)
    assert armdyn("import", "a.csv", "--output", "runs", "--guess")[0] == 0
    text = (tmp_path / "runs" / "map.toml").read_text()
    assert 'time = { column = "t", unit = "s", check = "no unit is written: seconds?" }' in text
