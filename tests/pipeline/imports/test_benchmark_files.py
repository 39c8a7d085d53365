"""Files of the forms in which the public benchmarks of nonlinear identification come; the numbers are made up."""

import json

import numpy as np
import pytest
from scipy.io import savemat

from armdyn.run import read_run

ROWS = 40
TWO_RUNS = """
time = { period = "4 s" }
description = "two tanks"

[runs.estimation.columns]
uEst = { channel = "extra.pump", unit = "V" }
yEst = { channel = "extra.level", unit = "V" }

[runs.validation]
description = "another day"
[runs.validation.columns]
uVal = { channel = "extra.pump", unit = "V" }
yVal = { channel = "extra.level", unit = "V" }
"""


@pytest.fixture
def columns():
    rng = np.random.default_rng(3)
    return {name: rng.uniform(1.0, 9.0, ROWS).round(4) for name in ("uEst", "uVal", "yEst", "yVal")}


def test_columns_of_one_table_become_two_runs_at_a_period(armdyn, tmp_path, columns):
    """As `dataBenchmark.csv` of the cascaded tanks: quoted names, a period in the first row only, a comma too many."""
    rows = [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    text = ['"uEst","uVal","yEst","yVal","Ts",', f"{rows[0]},4,", *(f"{row},," for row in rows[1:]), ""]
    (tmp_path / "dataBenchmark.csv").write_text("\r\n".join(text))
    (tmp_path / "map.toml").write_text(TWO_RUNS)
    status, said, _ = armdyn("import", "dataBenchmark.csv", "--map", "map.toml", "--output", "runs")
    assert status == 0
    assert "runs/dataBenchmark_validation.csv: extra.pump, extra.level, 156.0 s, 0.25 samples per second" in said
    assert "next: armdyn new --base FILE.py M.toml" in said
    for name, ending, about in (("estimation", "Est", "two tanks"), ("validation", "Val", "another day")):
        run = read_run(tmp_path / f"runs/dataBenchmark_{name}.csv")
        assert run.description == about
        for channel, column in (("extra.pump", f"u{ending}"), ("extra.level", f"y{ending}")):
            np.testing.assert_allclose(run.extra[channel].time, 4.0 * np.arange(ROWS))
            np.testing.assert_allclose(run.extra[channel].value, columns[column])


def test_a_matlab_file_of_a_slide_becomes_a_run(armdyn, tmp_path):
    """As `DATA_EMPS.mat`: columns of one name each, their own time, and a gain from V to N as a single number."""
    time = 0.001 * np.arange(ROWS)
    qm, vir = 0.2 * np.sin(30.0 * time), 3.0 * np.cos(30.0 * time)
    content = {"qm": qm, "qg": qm + 1e-4, "t": time, "vir": vir}
    savemat(tmp_path / "DATA.mat", {**{k: v[:, None] for k, v in content.items()}, "gtau": 35.0})
    (tmp_path / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[columns]\nqm = { channel = "q.slide", unit = "m" }\n'
        'qg = { channel = "q_cmd.slide", unit = "m" }\nvir = { channel = "tau.slide", unit = "N", scale = 35.0 }\n'
    )
    status, said, _ = armdyn("import", "DATA.mat", "--map", "map.toml", "--output", "runs", "--json", "-")
    assert status == 0
    assert json.loads(said)["runs"][0]["channels"]["tau.slide"]["unit"] == "N"
    run = read_run(tmp_path / "runs/DATA.csv")
    np.testing.assert_allclose(run.channels["q.slide"].time, time, atol=1e-12)
    np.testing.assert_allclose(run.channels["q.slide"].value, qm, atol=1e-12)
    np.testing.assert_allclose(run.channels["tau.slide"].value, 35.0 * vir)


@pytest.mark.parametrize(
    ("was", "wrong"),
    [
        ('"4 s"', '"4 V"'),
        ('"4 s"', '"0 s"'),
        ('"4 s"', '"4 h"'),
        ("runs.validation]", 'runs."../up"]'),
        ("[runs.estimation.columns]\n", "[runs.estimation.rows]\n"),
        ("yVal = {", "yMal = {"),
    ],
)
def test_what_is_wrong_with_a_run_of_a_mapping_is_told_in_its_place(refused, tmp_path, columns, was, wrong, complains):
    names, rows = ",".join(columns), zip(*columns.values(), strict=True)
    (tmp_path / "dataBenchmark.csv").write_text("\n".join([names, *(",".join(map(str, row)) for row in rows), ""]))
    (tmp_path / "map.toml").write_text(TWO_RUNS.replace(was, wrong))
    complains.line(refused("import", "dataBenchmark.csv", "--map", "map.toml", "--output", "runs"))
    assert not (tmp_path / "runs").exists()
