"""What can be watched is read from the effects' equations; a column is what the torque gains per unit of its effect."""

import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.arm.rigid import inverse_dynamics
from armdyn.effects.catalogue import CATALOGUE, find_several
from armdyn.errors import InputError
from armdyn.watch.watched import WatchedChanges

GAIN = 0.05


def test_columns_are_what_a_torque_gains_by_each_change(arm):
    model = arm.with_effect(CATALOGUE["torque_gain"])
    model = model.with_values({name: GAIN for name in model.names if "gain" in name})
    changes = WatchedChanges.of(model, find_several("rotor_inertia+joint_load_friction:elbow_joint"))
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1.0, 1.0, (3, 6))
    columns, _ = changes.function(q, v, a, 1e6)  # so fast a filter that the velocity's sign is certain
    rigid = inverse_dynamics(arm.arm.model, q[None], v[None], a[None])[0]
    friction = np.array([model.value(f"joint_coulomb_friction.torque[{joint}]") for joint in arm.joints])
    way, more = np.sign(v), 1.0 + GAIN
    expected = {
        "joint_coulomb_friction": more * way, "joint_viscous_friction": more * v, "torque_offset": np.ones(6),
        "torque_gain": more * (rigid + friction * way), "rotor_inertia": more * a,
        "joint_load_friction": more * np.abs(rigid) * way * (np.arange(6) == 2),
    }  # fmt: skip
    assert changes.names == tuple(expected)
    np.testing.assert_allclose(columns[:, changes.own].T, list(expected.values()), atol=1e-8)
    assert changes.units[0] == ("N m", "N m s/rad", "N m", "1", "kg m^2", "")
    heavier = arm.arm.model.copy()
    heavier.inertias[6] = heavier.inertias[6].FromDynamicParameters(arm.arm.described[-1] + np.eye(10)[0])
    gained = inverse_dynamics(heavier, q[None], v[None], a[None])[0] - rigid
    np.testing.assert_allclose(columns[:, 0], more * gained, atol=1e-8)


ONE_JOINT = """<robot name="one"><link name="base"/><link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="2" effort="20"/></joint></robot>"""


def test_an_arm_of_one_joint_is_watched_as_any(tmp_path):
    (tmp_path / "one.urdf").write_text(ONE_JOINT)
    changes = WatchedChanges.of(arm_model(tmp_path / "one.urdf"))
    q, a = 0.3, -2.0
    columns, _ = changes.function([q], [1.0], [a], 1e6)
    held = 2.0 * 9.81 * -0.2 * np.cos(q)
    expected = {
        "joint_coulomb_friction": 1.0, "joint_viscous_friction": 1.0, "torque_offset": 1.0,
        "torque_gain": (0.03 + 2.0 * 0.2**2) * a + held,
    }  # fmt: skip
    found = dict(zip(changes.names, columns[0, changes.own], strict=True))
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["torque_delay", "joint_stribeck_friction", "joint_coupling", "payload", "base_tilt"])
def test_an_effect_without_a_column_of_its_own_cannot_be_watched(arm, name, complains):
    with complains(InputError):
        WatchedChanges.of(arm, (CATALOGUE[name],))
