"""Small values that a model predicts with and does not name."""

import json
import tomllib

import numpy as np
import pytest

from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.model_file import ModelFile, model_text, read_model, write_model_file
from armdyn.run import write_run_csv

from . import urdfs

CROSS = [("along", "prismatic", "1 0 0", "0 0 0"), ("across", "prismatic", "0 1 0", "0 0 0")]
"""Two slides at right angles, 2 kg each: the first one moves both, and neither feels the other or gravity."""
FRICTION = "joint_viscous_friction.coefficient"
SMALL = {f"{FRICTION}[along]": 3.0, f"{FRICTION}[across]": 1.5, "torque_offset.torque[across]": -0.25}
HEAD = 'base = "arm"\nurdf = "arm.urdf"\njoints = ["along", "across"]\n'


@pytest.fixture
def arm(tmp_path):
    return urdfs.arm(tmp_path, CROSS, joints=["along", "across"])


def with_small(model, values=SMALL, width=0.3):
    return model.with_background(width, values, CATALOGUE.values())


def recorded(name, seed=0):
    """Both slides on waves; forces by Newton's law with the small values, and noise."""
    rub, offset = [SMALL[f"{FRICTION}[{joint}]"] for joint in ("along", "across")], [0.0, -0.25]

    def force(v, a, **_):
        return [4.0, 2.0] * a + rub * v + offset

    return urdfs.recorded(["along", "across"], ["m", "m"], force, 1500, seed, name, 0.02)


def forces(model, run):
    prepared = model.prepare_run(run)
    found = model.predict(prepared, model.theta())
    return {name: found.values[rows] for name, rows in found.slices.items()}


def test_predictions_count_small_values_in_as_named_ones(arm):
    run = recorded("a.csv")
    bare, small = forces(arm, run), forces(with_small(arm), run)
    named = arm.with_effect(find("joint_viscous_friction")).with_effect(find("torque_offset:across"))
    named = forces(named.with_values(SMALL), run)
    for name, ours in small.items():
        np.testing.assert_array_equal(ours, named[name])
        assert np.ptp(ours - bare[name]) > 1.0
    np.testing.assert_array_equal(forces(with_small(arm).without_background(), run)["tau.across"], bare["tau.across"])


def test_the_background_is_held_and_has_no_names(arm):
    model = with_small(arm.with_effect(find("joint_viscous_friction:along")), {f"{FRICTION}[across]": 1.5})
    assert [effect.label for effect in model.named_effects] == ["joint_viscous_friction:along"]
    assert "joint_viscous_friction:along, background of 1 small value" in str(model)
    assert [p.fitted for p in model.parameters.values()] == [True, False]
    assert model.without_background().names == (f"{FRICTION}[along]",)
    table = model.to_dataframe("background")
    assert list(table["joint"]) == ["across"]
    assert list(table["typical_sizes"] * model.parameters[f"{FRICTION}[across]"].typical) == [pytest.approx(1.5)]
    assert list(model.to_dataframe("parameters")["parameter"]) == [f"{FRICTION}[along]"]


def test_an_effect_that_gets_a_name_leaves_the_background(arm):
    model = with_small(arm)
    named = model.with_effect(find("joint_viscous_friction:across"))
    assert named.background.names == (f"{FRICTION}[along]", "torque_offset.torque[across]")
    assert (named.value(f"{FRICTION}[across]"), named.parameters[f"{FRICTION}[across]"].fitted) == (0.0, True)
    assert [effect.label for effect in named.named_effects] == ["joint_viscous_friction:across"]
    rest = model.without_effect("joint_viscous_friction").without_effect("torque_offset")
    assert (rest.background, rest.effects) == (None, ())
    assert model.with_only_effects(["torque_offset"]).background.names == ("torque_offset.torque[across]",)


def test_a_new_background_replaces_the_old_one(arm):
    model = with_small(with_small(arm), {"torque_offset.torque[along]": 0.1}, 2.0)
    assert (model.background.width, model.background.names) == (2.0, ("torque_offset.torque[along]",))
    assert model.names == model.background.names
    assert with_small(model, {}).background is None


def test_a_model_file_holds_the_background(arm, tmp_path):
    model = with_small(arm.with_effect(find("rotor_inertia")).with_values({"rotor_inertia.inertia[along]": 0.1}))
    file = ModelFile(model, {"joints": ["along", "across"]})
    write_model_file(tmp_path / "m.toml", file)
    text = (tmp_path / "m.toml").read_text()
    table = tomllib.loads(text)
    assert table["effects"] == ["rotor_inertia"]
    assert list(table["parameters"]) == ["rotor_inertia.inertia[along]", "rotor_inertia.inertia[across]"]
    assert table["background"] == {"width": 0.3, "values": SMALL}
    again = read_model(tmp_path / "m.toml")
    assert (again.names, again.parameters, again.background) == (model.names, model.parameters, model.background)
    assert model_text(ModelFile(again, file.description), tmp_path) == text


ENTRIES = (
    '"rub.c[along]" = 1.0', '"torque_offset.torque[alon]" = 1.0', '"torque_offset.force[along]" = 1.0',
    '"torque_offset.torque" = 1.0', '"base_tilt.roll[along]" = 1.0', f'"{FRICTION}[across]" = nan',
    f'"{FRICTION}[across]" = -1.0', f'"{FRICTION}[across]" = "1 N"', f'"{FRICTION}[along]" = 1.0',
)  # fmt: skip


@pytest.mark.parametrize(
    "entries",
    [*(f"width = 0.3\nvalues = {{ {entry} }}" for entry in ENTRIES),
     "width = -0.3\nvalues = {}", "values = {}", "width = 0.3\nvalue = {}"],
)  # fmt: skip
@pytest.mark.usefixtures("arm")
def test_a_background_that_cannot_be_read_is_one_line(refused, tmp_path, entries, complains):
    text = f'{HEAD}effects = ["joint_viscous_friction:along"]\n[background]\n{entries}\n'
    (tmp_path / "m.toml").write_text(text)
    complains.line(refused("export", "m.toml", "--output", "m.json"))
    assert not (tmp_path / "m.json").exists()


@pytest.mark.parametrize("table", ["background = 3", "[[background]]\nwidth = 0.3\nvalues = {}", "drives.a = 3"])
@pytest.mark.usefixtures("arm")
def test_what_is_no_table_is_one_line(refused, tmp_path, table, complains):
    (tmp_path / "m.toml").write_text(f"{HEAD}effects = []\n{table}\n")
    complains.line(refused("export", "m.toml", "--output", "m.json"))


@pytest.fixture
def place(arm, tmp_path, armdyn):
    """A folder with a model that has a background, and runs that show nothing else."""
    write_model_file(tmp_path / "m.toml", ModelFile(with_small(arm), {"joints": ["along", "across"]}))
    for seed, name in enumerate(("a.csv", "b.csv")):
        write_run_csv(recorded(name, seed), tmp_path / name)
    return armdyn


def test_compare_predicts_with_the_background_as_it_is(place, tmp_path):
    status, out, _ = place("compare", "m.toml", "a.csv", "--held-out", "b.csv", "--json", "answer.json")
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert (status, answer["verdict"]) == (0, "explained")
    assert answer["background"] == {"width": 0.3, "values": SMALL}
    assert answer["parameters"] == {}
    assert answer["model"]["effects"] == []
    assert "a background of 3 small values, of a width of 0.3 typical sizes" in out


def test_a_repair_begins_without_the_background(place, tmp_path):
    status, out, err = place("repair", "m.toml", "a.csv", "--held-out", "b.csv", "--output", "n.toml", "--named-only")
    assert (status, err) == (0, "")
    assert "The background of 3 small values of the model as given is set aside, to be found anew." in out
    table = tomllib.loads((tmp_path / "n.toml").read_text())
    assert "background" not in table
    for joint in ("along", "across"):
        found = table["parameters"][f"{FRICTION}[{joint}]"]["value"]
        assert found == pytest.approx(SMALL[f"{FRICTION}[{joint}]"], rel=0.05)
