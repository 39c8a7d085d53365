"""One row per recording, whatever is wrong with it; done once, and again when something changed."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from armdyn.checked_study import CheckedStudy
from armdyn.run import Channel, read_run, write_run_csv
from pipeline.batch.run import JOURNAL_FILE
from pipeline.batch.work import BatchJob, run_job
from pipeline.trial.folder import locked_folder

from .conftest import BATCH, FEW

pq = pytest.importorskip("pyarrow.parquet")


def rows(folder):
    return pq.read_table(folder / "out/batch.parquet").to_pylist()


def answer(folder):
    return json.loads((folder / "out.json").read_text())


def test_columns_carry_units_and_standard_deviations(done):
    row = rows(done)[0]
    assert row["value.payload.mass[wrist_3_joint] [kg]"] == pytest.approx(1.4, abs=0.65)
    assert 0 < row["std.payload.mass[wrist_3_joint] [kg]"] < 0.05
    assert 0 < row["rmse.tau.elbow_joint [N m]"] < 1.0
    assert row["duration [s]"] == pytest.approx(2.49)
    assert row["verdict"] in ("explained", "not_explained")
    assert row["time_from"] == "name"
    assert row["seconds"] > 0


def test_only_what_is_new_changed_or_was_cut_off_is_done_again(done, armdyn, monkeypatch):
    def worked():
        armdyn(*BATCH)
        return answer(done)["worked"]

    before = rows(done)
    with monkeypatch.context() as nobody:
        nobody.setattr("pipeline.batch.run.run_job", None)  # may be asked for it
        assert worked() == 0
    assert rows(done) == before
    journal = done / "out" / JOURNAL_FILE
    journal.write_bytes(journal.read_bytes()[:-40])
    assert worked() == 1
    log, other = sorted((done / "robots/robot_00/logs").glob("*.csv"))[:2]
    log.with_suffix(".toml").write_text("recorded = 2026-03-01T12:00:00+02:00\n")
    assert worked() == 1
    (row,) = (row for row in rows(done) if row["recording"].endswith(log.name))
    assert (row["time"].isoformat(), row["time_from"]) == ("2026-03-01T10:00:00+00:00", "sidecar")
    other.write_text(other.read_text().replace("time [s]", "time  [s]"))
    assert worked() == 1
    model = done / "robots/robot_00/model.toml"
    model.write_text(model.read_text().replace('"joint_viscous_friction", ', ""))
    assert worked() == FEW
    name = "value.joint_viscous_friction.coefficient[elbow_joint] [N m s/rad]"
    assert all(row.get(name) is None for row in rows(done))


def test_bad_files_become_rows_and_never_end_the_batch(lab, armdyn):
    logs = lab / "robots/robot_00/logs"
    (logs / "log_2026-02-01.csv").write_text("time [s],q.elbow\n0,1\n")
    (logs / "log_2026-02-02.csv").write_bytes(b"\x00\xff" * 500)
    (logs / "log_2026-02-03.csv").mkdir()
    (logs / "log_2026-02-04.csv").symlink_to("nowhere.csv")
    status, out, _ = armdyn(*BATCH)
    assert status == 0
    bad = {row["recording"].rpartition("/")[2]: row for row in rows(lab) if row["problem"]}
    assert sorted(bad) == [f"log_2026-02-0{day}.csv" for day in (1, 2, 3, 4)]
    assert all(row["verdict"] is None and row["value.payload.mass[wrist_3_joint] [kg]"] is None for row in bad.values())
    assert len(rows(lab)) == FEW + 4
    assert "4 could not be used" in out
    assert "Traceback" not in out


@pytest.mark.slow
def test_something_unforeseen_in_one_recording_is_its_row_and_is_tried_again(lab, armdyn, monkeypatch):
    usual = CheckedStudy.compare

    def fails(given):
        if given.study.runs[0].name == "log_2026-01-08.csv":
            raise ZeroDivisionError("of a mistake in armdyn")
        return usual(given)

    monkeypatch.setattr(CheckedStudy, "compare", fails)
    monkeypatch.setattr("pipeline.batch.run.START_METHOD", "fork")  # which takes the change along
    armdyn(*BATCH)
    bad = [row for row in rows(lab) if row["problem"]]
    assert bad
    assert all("ZeroDivisionError" in row["problem"] for row in bad)
    monkeypatch.setattr(CheckedStudy, "compare", usual)
    armdyn(*BATCH)
    assert answer(lab)["worked"] == len(bad)
    assert not [row for row in rows(lab) if row["problem"]]


@pytest.mark.slow
def test_repair_says_what_each_recording_lacks(lab, armdyn):
    model = lab / "robots/robot_00/model.toml"
    model.write_text(re.sub(r"effects = .*", "effects = []", model.read_text()))
    log = min((lab / "robots/robot_00/logs").glob("*.csv")).relative_to(lab)
    (lab / "spec.toml").write_text(
        f'task = "repair"\n[[recordings]]\nrobot = "the first"\nmodel = "robots/robot_00/model.toml"\nruns = "{log}"\n'
    )
    armdyn(*BATCH)
    (row,) = rows(lab)
    assert row["robot"] == "the first"
    assert {"joint_viscous_friction", "joint_coulomb_friction", "payload"} <= set(row["effects"])
    assert row["explained"] > 0.95


@pytest.mark.usefixtures("lab")
def test_another_batch_in_the_same_folder_is_refused(refused, complains):
    with locked_folder(Path("out"), Path("out")):
        complains.line(refused(*BATCH))


def test_a_recording_that_is_not_what_it_says_has_no_values_unless_it_is_trusted(lab):
    log = sorted((lab / "robots/robot_00/logs").glob("*.csv"))[0]
    run = read_run(log)
    negated = {n: Channel(c.time, -c.value, c.unit) for n, c in run.channels.items() if n.startswith("tau.")}
    write_run_csv(replace(run, channels={**run.channels, **negated}), log)
    job = BatchJob("key", "compare", lab / "robots/robot_00/model.toml", "", log, None)
    wrong = run_job(job)
    assert "all torques have the wrong sign" in wrong.problem
    assert "trust_data" in wrong.problem
    assert not wrong.verdict
    assert "sign" not in run_job(replace(job, trust=True)).problem
