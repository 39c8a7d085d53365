"""Real arms: an EMPS slide and a UR10e. The recordings are not in the repository; without them nothing is tested."""

import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.arm.rigid import is_physical
from armdyn.effects.catalogue import find
from armdyn.run import read_run

from .conftest import RECORDINGS, fitted, total_rmse

pytestmark = pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not there")


def with_effects(model, *names):
    for name in names:
        model = model.with_effect(find(name))
    return model


@pytest.fixture(scope="module")
def emps():
    model = arm_model(urdf=RECORDINGS / "emps/emps.urdf")
    return model, *(model.prepare_run(read_run(RECORDINGS / f"emps/emps_{n}.csv")) for n in ("reference", "pulses"))


@pytest.fixture(scope="module")
def ur10e():
    model = arm_model(urdf=RECORDINGS / "ur10e/ur10e.urdf")
    names = ("20_02_10-30sec_12harm", "20_02_12-50sec_12harm", "20_02_06-20sec_5harm")
    return model, *(model.prepare_run(read_run(RECORDINGS / f"ur10e/ur-{n}.csv")) for n in names)


def test_emps_gives_the_published_parameters(emps):
    model, reference, pulses = emps
    assert total_rmse(model, pulses) > 50.0
    friction = ("joint_viscous_friction", "joint_coulomb_friction", "torque_offset")
    found, _ = fitted(with_effects(model, "link_inertia", *friction), [reference])
    assert total_rmse(found, pulses) < 3.8
    assert found.link_parameters()["slide"][0] == pytest.approx(95.1089, rel=0.01)
    assert found.value("joint_viscous_friction.coefficient[slide]") == pytest.approx(203.5034, rel=0.01)
    assert found.value("joint_coulomb_friction.torque[slide]") == pytest.approx(20.3935, rel=0.03)
    assert found.value("torque_offset.torque[slide]") == pytest.approx(-3.1648, rel=0.03)


def test_ur10e_is_predicted_on_a_motion_that_was_held_out(ur10e):
    model, *training, held_out = ur10e
    assert total_rmse(model, held_out) > 25.0
    full = with_effects(model, "joint_viscous_friction", "joint_coulomb_friction", "link_inertia")
    found, _ = fitted(full, training, most_steps=25)
    assert total_rmse(found, held_out) < 5.2  # N m up to 10 Hz, with the ripple of the drives; up to 2.5 Hz it is 3.8
    assert all(is_physical(p) for p in found.link_parameters().values())
    friction = [found.value(n) for n in found.names if n.startswith("joint_")]
    assert min(friction) > 0.0
    least_squares = [17.9, 16.6, 8.9, 2.8, 2.0, 2.8, 14.3, 14.7, 5.8, 2.4, 3.0, 2.5]
    assert np.array(friction) == pytest.approx(np.array(least_squares), rel=0.2)


def test_ur10e_friction_grows_with_the_load(ur10e):
    model, *training, held_out = ur10e
    base = with_effects(model, "joint_viscous_friction", "joint_coulomb_friction", "rotor_inertia")
    plain, _ = fitted(base, training)
    loaded, _ = fitted(base.with_effect(find("joint_load_friction")), training)
    assert total_rmse(loaded, held_out) < 0.95 * total_rmse(plain, held_out)


def test_ur10e_rotors_do_not_become_negative_to_mend_links(ur10e):
    # Free of bounds, plain least squares gives -1.4 kg m^2 for the second joint.
    model, *training, _ = ur10e
    found, estimate = fitted(
        with_effects(model, "joint_viscous_friction", "joint_coulomb_friction", "rotor_inertia"), training
    )
    assert found.value("rotor_inertia.inertia[shoulder_lift_joint]") == 0.0
    assert "rotor_inertia.inertia[shoulder_lift_joint]" in estimate.at_bound
