"""Bodies that other effects replace: a leg whose rotors look like the inertia of a link, in MuJoCo."""

from xml.etree import ElementTree as ET

import numpy as np
from worlds.mujoco_plant import Hidden, Path, bare, compiled, simulated

import urdf
from armdyn.arm.model import arm_model
from armdyn.front import repair
from armdyn.run import Run
from urdf.find import distribution_file

JOINTS = ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
ON_ALL = {
    "joint_viscous_friction": ("coefficient", (0.06, 0.05, 0.08)),
    "joint_coulomb_friction": ("torque", (0.35, 0.3, 0.55)),
    "rotor_inertia": ("inertia", (0.008, 0.008, 0.018)),
}
PERIOD = 0.002  # s


def leg_runs(file, rng):
    """Three runs of a leg with frictions, rotors and a load at the foot."""
    leg = urdf.load(file, meshes=False, joints=JOINTS)
    hidden = [
        Hidden(name, joint, {short: value})
        for name, (short, values) in ON_ALL.items()
        for joint, value in zip(JOINTS, values, strict=True)
    ]
    hidden.append(Hidden("payload", JOINTS[-1], {"mass": 0.18, "x": 0.0, "y": 0.0, "z": -0.2}))
    plant = compiled(ET.tostring(bare(leg.urdf_xml, JOINTS), encoding="unicode"), JOINTS, tuple(hidden))
    for i in range(3):
        sines = rng.uniform(0.12, 0.36, (3, 3)), rng.uniform(0.2, 1.5, (3, 3)), rng.uniform(0, 6.28, (3, 3))
        path = Path(np.array([0.0, 0.8, -1.6]), *sines, 25.0)
        log = simulated(plant, JOINTS, path, 4, np.full(3, 20.0), None)
        noise = [size * rng.standard_normal(log.q.shape) for size in (2e-5, 0.05, 0.01)]
        read = {"q": log.q + noise[0], "v": log.v + noise[2], "tau": log.torque + noise[1]}
        yield Run.from_arrays(np.arange(len(log.q)) * PERIOD, read, joints=JOINTS, name=f"run {i}")


def test_rotors_are_not_called_the_inertia_of_a_link():
    """Linearised at a fit with the thigh's inertia, rotors promised nothing, though two predict as well as its ten."""
    file = distribution_file("example-robot-data", "go2_description/urdf/go2.urdf")
    found = repair(arm_model(file, joints=JOINTS), list(leg_runs(file, np.random.default_rng(5))))
    on = {one.effect: set(one.joints) for one in found.named}
    assert {name: on.get(name) for name in ON_ALL} == {name: set(JOINTS) for name in ON_ALL}
    assert on["payload"] == {"FL_calf_joint"}
    assert "link_inertia" not in on
