"""Links in kg, m and kg m^2."""

import numpy as np
import pytest
from worlds.baxter import generate

from armdyn.arm.links import LINK_QUANTITIES, link_inertia_changes
from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.identify.repair import changed_links_of_fit
from armdyn.identify.studies import make_study

from . import urdfs

NAMES = [name for name, _ in LINK_QUANTITIES]


@pytest.fixture
def pendulum(tmp_path):
    return urdfs.arm(tmp_path, urdfs.PENDULUM).with_effect(find("link_inertia"))


def changes(model, theta, std=0.1, alone=0.1):
    size = len(theta)
    one = np.eye(size)
    return link_inertia_changes(
        model.arm, model.changed_links(theta), std**2 * one, alone**2 * one, np.ones(size, dtype=bool)
    )


def test_a_link_as_described_has_the_urdfs_mass_centre_and_inertia(pendulum):
    (link,) = changes(pendulum, pendulum.theta())
    expected = [2.0, 0.1, 0.0, 0.0, 0.01, 0.0, 0.02, 0.0, 0.0, 0.02, 0.2, 0.0, 0.0]
    assert [q.described for q in link.quantities] == pytest.approx(expected, abs=1e-12)
    assert [q.value for q in link.quantities] == pytest.approx(expected, abs=1e-12)
    assert link.physical
    assert link.warning == ""


def test_standard_deviations_are_those_of_finite_differences(pendulum):
    theta = 0.1 * np.arange(10) - 0.4
    (link,) = changes(pendulum, theta, std=0.2)

    def values(at):
        return np.array([q.value for q in changes(pendulum, at)[0].quantities])

    step = 1e-6 * np.eye(10)
    slopes = np.array([(values(theta + d) - values(theta - d)) / 2e-6 for d in step])
    assert [q.std for q in link.quantities] == pytest.approx(0.2 * np.linalg.norm(slopes, axis=0), rel=1e-5)


def test_a_heavier_link_keeps_its_centre_and_grows_in_inertia(pendulum):
    (link,) = changes(pendulum.with_values({"link_inertia.mass[swing]": 0.3}), np.array([0.3, *[0.0] * 9]))
    value = {q.name: q.value / q.described for q in link.quantities if q.described}
    ratio = np.exp(0.3)
    assert value == pytest.approx(
        dict.fromkeys(value, ratio) | {n: 1.0 for n in value if n.startswith("centre")}, rel=1e-9
    )


def test_an_absurd_mass_is_pointed_out(pendulum):
    (link,) = changes(pendulum, np.array([2.0, *[0.0] * 9]), alone=10.0)
    assert link.warning.startswith(
        "the link of swing weighs 14.8 kg in the model (URDF: 2 kg), which these runs do not"
    )
    assert changes(pendulum, np.array([1.0, *[0.0] * 9]))[0].warning == ""


def test_joints_without_an_effect_on_their_link_are_left_out(baxter):
    model = baxter.with_effect(find("payload")).with_effect(find("joint_viscous_friction"))
    (link,) = changes(model, model.theta())
    assert link.joint == "right_w2"


def test_torques_determine_the_last_links_moments_and_no_links_mass():
    runs = [generate("link_inertia", 1.0, 1, recording=k, duration=10.0) for k in range(2)]
    study = make_study(arm_model(robot="baxter").with_effect(find("link_inertia")), runs, [], [])
    links = {link.joint: {q.name: q for q in link.quantities} for link in changed_links_of_fit(study, study.first())}
    assert not any(link["mass"].determined for link in links.values())
    last = links["right_w2"]
    assert last["moment_z"].unit == "kg m"
    assert not last["moment_z"].determined  # it adds to the links before
    assert last["inertia_zz"].determined  # nothing else turns about that axis
    true = np.exp(0.2) * last["inertia_zz"].described
    assert abs(last["inertia_zz"].value - true) < 4 * last["inertia_zz"].std
