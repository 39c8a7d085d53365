import pytest
from hidden_effects.arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.study import Study
from armdyn.model_file import ModelFile, write_model_file
from armdyn.run import write_run_csv
from pipeline.workbench.bench import Bench

HIDDEN = "joint_viscous_friction"
RIVALS = ("joint_coulomb_friction", "torque_offset", "payload")


@pytest.fixture(scope="package")
def recordings():
    """Two recordings of Baxter with a friction that no model knows, the second to be held out."""
    return [generate(HIDDEN, 1.0, 0, rate=100.0, duration=6.0, recording=i) for i in range(2)]


@pytest.fixture(scope="package")
def bench(recordings):
    catalogue = [CATALOGUE[name] for name in (HIDDEN, *RIVALS)]
    return Bench(Study(arm_model(robot="baxter"), recordings[:1], recordings[1:], catalogue))


@pytest.fixture(scope="package")
def files(recordings, tmp_path_factory):
    """The same as files: model, recording, held-out recording."""
    folder = tmp_path_factory.mktemp("files")
    write_model_file(folder / "m.toml", ModelFile(arm_model(robot="baxter"), {"robot": "baxter"}))
    for run, name in zip(recordings, ("a.csv", "b.csv"), strict=True):
        write_run_csv(run, folder / name)
    return folder / "m.toml", folder / "a.csv", folder / "b.csv"
