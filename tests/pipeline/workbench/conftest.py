import os
import re
import subprocess
import sys
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
from worlds.baxter import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.studies import make_study
from armdyn.model_file import ModelFile, write_model_file
from armdyn.run import write_run_csv
from pipeline.workbench.bench import Workbench

HIDDEN = "joint_viscous_friction"
RIVALS = ("joint_coulomb_friction", "torque_offset", "payload")


@pytest.fixture(scope="package")
def recordings():
    """Two recordings of Baxter with a friction that no model knows, the second to be held out."""
    return [generate(HIDDEN, 1.0, 0, rate=100.0, duration=6.0, recording=i) for i in range(2)]


@pytest.fixture(scope="package")
def bench(recordings):
    catalogue = [CATALOGUE[name] for name in (HIDDEN, *RIVALS)]
    return Workbench(make_study(arm_model(robot="baxter"), recordings[:1], recordings[1:], catalogue))


@pytest.fixture(scope="package")
def files(recordings, tmp_path_factory):
    """The same as files: model, recording, held-out recording."""
    folder = tmp_path_factory.mktemp("files")
    write_model_file(folder / "m.toml", ModelFile(arm_model(robot="baxter"), {"robot": "baxter"}))
    for run, name in zip(recordings, ("a.csv", "b.csv"), strict=True):
        write_run_csv(run, folder / name)
    return folder / "m.toml", folder / "a.csv", folder / "b.csv"


@contextmanager
def workbench(folder, *arguments):
    """A workbench's process, and the address that it printed; its temporary files are in `folder`/tmp."""
    pytest.importorskip("nicegui", reason="needs the extra 'workbench': pip install 'armdyn[workbench]'")
    command = [sys.executable, "-m", "pipeline.cli", "workbench", "--no-browser", *map(str, arguments)]
    (folder / "tmp").mkdir()
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          env={**os.environ, "TMPDIR": str(folder / "tmp")}) as process:  # fmt: skip
        try:
            said = process.stdout.readline()
            found = re.search(r"http://\S+\?token=[\w-]+", said)
            assert found, said + process.stderr.read()
            yield process, urlsplit(found[0])
        finally:
            process.kill()
