"""Values that no robot has are findings, where recordings determine them."""

from dataclasses import replace

import pytest
from worlds import mistakes, sound_recordings

from armdyn.arm.model import arm_model
from armdyn.effect_model import Background
from armdyn.effects.catalogue import CATALOGUE
from armdyn.inspection.plausible import implausible_values

MASS = "link_inertia.mass[panda_joint3]"  # logarithm of a factor


@pytest.fixture(scope="module")
def panda():
    return arm_model(robot="panda", joints=mistakes.Plant("panda").joints, effects=[CATALOGUE["link_inertia"]])


def _sentences(model, runs=()):
    return [check.sentence for check in implausible_values(model, runs)]


@pytest.mark.parametrize(
    ("logarithm", "std", "said"),
    [
        (4.0, 0.05, "more than the arm"), (4.0, 1.0, ""),
        (-3.0, 0.1, "next to nothing"), (-5.0, 2.0, ""), (-1.0, 0.1, ""),
    ],
)  # fmt: skip
def test_a_link_in_kg_is_judged_with_its_own_deviation(panda, logarithm, std, said):
    found = _sentences(panda.with_parameters({MASS: panda.parameters[MASS].with_value(logarithm, std)}))
    assert len(found) == bool(said)
    assert said in "".join(found)


def test_small_values_without_a_name_are_no_findings(panda):
    heavy = panda.with_parameters({MASS: panda.parameters[MASS].with_value(4.0)})
    names = tuple(name for name in panda.names if name.endswith("[panda_joint3]"))
    assert _sentences(heavy)
    assert not _sentences(replace(heavy, background=Background(1.0, names)))


def test_an_arm_that_no_torque_holds_is_named(panda):
    run = sound_recordings.arm("panda", "as described", 0, duration=6.0).run
    light = panda.with_values({f"link_inertia.mass[{joint}]": -4.0 for joint in panda.joints})
    assert "gravity is not in the torques" in _sentences(light, [run])[-1]
    assert not _sentences(panda, [run])
