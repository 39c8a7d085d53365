"""Files of the forms in which the public benchmarks of nonlinear identification come; the numbers are made up."""

import numpy as np
import pytest

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


WRONG = [
    ('"4 s"', '"4 V"'), ('"4 s"', '"0 s"'), ('"4 s"', '"4 h"'), ("runs.validation]", 'runs."../up"]'),
    ("[runs.estimation.columns]\n", "[runs.estimation.rows]\n"), ("yVal = {", "yMal = {"),
]  # fmt: skip


@pytest.mark.parametrize(("was", "wrong"), WRONG)
def test_what_is_wrong_with_a_run_of_a_mapping_is_told_in_its_place(refused, tmp_path, columns, was, wrong, complains):
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows), ""]
    (tmp_path / "dataBenchmark.csv").write_text("\n".join(lines))
    (tmp_path / "map.toml").write_text(TWO_RUNS.replace(was, wrong))
    complains.line(refused("import", "dataBenchmark.csv", "--map", "map.toml", "--output", "runs"))
    assert not (tmp_path / "runs").exists()
