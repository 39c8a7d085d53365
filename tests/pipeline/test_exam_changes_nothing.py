"""Every command that takes an exam gives the same values and names with one, without, and with one of nonsense."""

import contextlib
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import called
from worlds import hobby_arm, imperfect_arm

from armdyn.run import Run, read_run, write_run_csv

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
OF_EXAM = [
    "exam",
    "exam_rmse",
    "coverage",
    "covered",
    "does_not_hold_in",
    "rollout",
    "recording_checks",
    "left_out",
    "sentence",
    "remarks",
    "share",
    "explained",
]
"""Entries that say something of the exam; shares are measured on it."""


def servo(folder: Path) -> tuple[list[str], list[Path]]:
    (folder / "arm.urdf").write_text(hobby_arm.urdf_text())
    files = []
    for seed in range(2):
        q, told = hobby_arm.recorded(folder / "arm.urdf", seed)
        columns = {f"q.{j}": q[:, i] for i, j in enumerate(hobby_arm.JOINTS)}
        columns |= {f"q_cmd.{j}": told[:, i] for i, j in enumerate(hobby_arm.JOINTS)}
        files.append(folder / f"motion_{seed}.csv")
        time = np.arange(len(q)) / hobby_arm.FPS
        write_run_csv(Run.from_arrays(time, columns, name=files[-1].stem, joints=None), files[-1])
    return ["arm", "--urdf", "arm.urdf", "--drive", "sts3215=all"], files


def ur5(folder: Path) -> tuple[list[str], list[Path]]:
    world = imperfect_arm.generate("ur5", "coulomb", 3, duration=10.0)
    files = [folder / "training.csv", folder / "last.csv"]
    for run, file in zip((world.train[0], world.recordings[-1].run), files, strict=True):
        write_run_csv(run, file)
    return ["arm", "--robot", "ur5"], files


def swing(_: Path) -> tuple[list[str], list[Path]]:
    return ["pendulum"], [EXAMPLES / f"pendulum/{name}.csv" for name in ("swing_1", "swing_2")]


COMMANDS = {
    "compare": ["compare"],
    "add": ["add", "joint_viscous_friction"],
    "add pendulum": ["add", "quadratic_drag"],
    "diagnose": ["diagnose"],
    "repair": ["repair"],
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The model's file, a training run, an exam, and an exam of nonsense, by kind; each is made once."""
    known = {}

    def make(kind):
        if kind not in known:
            folder = tmp_path_factory.mktemp(kind.__name__)
            new, (training, exam) = kind(folder)
            with contextlib.chdir(folder):
                assert called("new", new[0], "m.toml", *new[1:])[0] == 0
            known[kind] = folder / "m.toml", training, exam, nonsense(exam, folder / "nonsense.csv")
        return known[kind]

    return make


def nonsense(exam: Path, path: Path) -> Path:
    """A recording with the channels of an exam: in each, its samples in the opposite order, and noise of their size."""
    run, random = read_run(exam), np.random.default_rng(1)
    channels = {
        name: replace(c, value=c.value[::-1] + np.std(c.value) * random.normal(size=len(c)))
        for name, c in run.channels.items()
    }
    write_run_csv(replace(run, channels=channels, name=path.stem, source=None), path)
    return path


def answer(arguments: list, folder: Path) -> dict:
    """JSON of a command and the model that it wrote, without what is of the exam or of the time."""
    files = {"--json": folder / "answer.json"}
    if arguments[0] in ("add", "repair"):
        files["--output"] = folder / "out.toml"
    status, _, complaint = called(*arguments, *(text for option in files.items() for text in option))
    assert status == 0, complaint
    written = tomllib.loads(files["--output"].read_text()) if "--output" in files else {}
    return flat(json.loads(files["--json"].read_text()), "json") | flat(written, "file")


def flat(entry, name: str = "") -> dict:
    """Numbers and words of an answer by their place, without what is of the exam."""
    if isinstance(entry, dict):
        entry = {f"{name}.{k}": v for k, v in entry.items() if k not in OF_EXAM}
    elif isinstance(entry, list):
        entry = {f"{name}[{i}]": v for i, v in enumerate(entry)}
    else:
        return {name: entry}
    return {k: v for key, value in entry.items() for k, v in flat(value, key).items()}


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        (servo, "compare"),
        pytest.param(servo, "add", marks=pytest.mark.slow),
        pytest.param(servo, "diagnose", marks=pytest.mark.slow),
        pytest.param(servo, "repair", marks=pytest.mark.slow),
        (ur5, "compare"),
        (ur5, "add"),
        pytest.param(ur5, "diagnose", marks=pytest.mark.slow),
        pytest.param(ur5, "repair", marks=pytest.mark.slow),
        (swing, "compare"),
        pytest.param(swing, "add pendulum", marks=pytest.mark.slow),
        pytest.param(swing, "diagnose", marks=pytest.mark.slow),
        pytest.param(swing, "repair", marks=pytest.mark.slow),
    ],
)
def test_values_and_names_do_not_depend_on_an_exam(recorded, tmp_path, kind, command):
    model, training, exam, wrong = recorded(kind)
    word, *names = COMMANDS[command]
    plain = answer([word, model, *names, training], tmp_path)
    for given in (exam, wrong):
        found = answer([word, model, *names, training, "--exam", given], tmp_path)
        assert {k: (plain.get(k), found.get(k)) for k in {**plain, **found} if plain.get(k) != found.get(k)} == {}


@pytest.mark.parametrize(("kind", "command"), [(servo, "compare"), (ur5, "add"), (swing, "compare")])
def test_values_of_a_model_that_is_given_do_not_depend_on_held_out_runs(recorded, tmp_path, kind, command):
    model, training, other, wrong = recorded(kind)
    word, *names = COMMANDS[command]
    plain = answer([word, model, *names, training], tmp_path)
    for given in (other, wrong):
        found = answer([word, model, *names, training, "--held-out", given, "--trust-data"], tmp_path)
        values = [fitted_values(one) for one in (plain, found)]
        assert values[0] == pytest.approx(values[1], rel=1e-4)  # a fit ends where a step gains nothing
        assert values[0]


def fitted_values(found: dict) -> dict[str, float]:
    numbers = {name: value for name, value in found.items() if isinstance(value, float)}
    return {name: value for name, value in numbers.items() if ".parameters" in name or ".drives" in name}
