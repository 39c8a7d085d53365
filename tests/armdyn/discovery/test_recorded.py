"""Laws that depend on a further column of the recordings: found, with kind and units; and none where there is none."""

import pytest

from armdyn.arm.model import arm_model
from armdyn.discovery.discover import discover
from armdyn.effects.user import available_effects, load_effects
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model

from ...worlds.laws import URDF, world


@pytest.fixture
def model(tmp_path):
    """Of a world."""

    def of(given):
        if given.base == "pendulum":
            return pendulum_model(given.length, given.mass)
        (tmp_path / "two.urdf").write_text(URDF)
        return arm_model(urdf=tmp_path / "two.urdf")

    return of


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "joint"), [("friction by temperature", None), ("joint friction by temperature", "elbow")]
)
def test_a_friction_that_falls_with_a_recorded_temperature_is_found(model, tmp_path, kind, joint):
    given = world(kind, 0)
    found = discover(make_study(model(given), given.runs, [given.held_out], available_effects(model(given))))
    (law,) = found.laws_outside_catalogue
    assert (law.kind, law.joint) == ("friction by temperature", joint)
    assert law.depends_on == ("extra.temperature", "speed")
    assert {name: value.unit for name, value in law.values.items()} == {"coefficient": "N m s/rad", "width": "K"}
    assert all(error <= 1.2 * found.noise[channel] for channel, error in found.held_out_rmse.items())
    found.write(tmp_path / "law.py")
    (effect,) = load_effects(tmp_path / "law.py")
    assert effect.columns["extra_temperature"].usual == pytest.approx(295.0, abs=5.0)
    assert any(curve.against == "extra.temperature" for curve in found.missing_force)


@pytest.mark.parametrize("kind", ["clean pendulum with temperature", "clean arm with temperature"])
def test_a_temperature_beside_a_clean_recording_is_no_law(model, kind):
    given = world(kind, 0)
    found = discover(make_study(model(given), given.runs, [given.held_out], available_effects(model(given))))
    assert (found.laws, found.sentence) == ((), "Nothing is missing: what is left is noise.")
