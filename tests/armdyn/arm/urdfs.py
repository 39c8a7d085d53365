"""Small arms as URDF text, and as models."""

import numpy as np

from armdyn.arm.model import arm_model
from armdyn.run import Channel, Run


def chain(joints):
    """URDF of a chain; each joint is (name, type, axis, origin xyz), each link has 2 kg 0.1 m along its x axis."""
    parts = ['<robot name="chain"><link name="base"/>']
    parent = "base"
    for name, kind, axis, origin in joints:
        limit = '<limit lower="-2" upper="2" effort="100" velocity="2"/>'
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>'
            '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{limit}</joint>'
        )
        parent = f"{name}_link"
    return "\n".join([*parts, "</robot>"])


def arm(folder, described, **settings):
    """The model of a `chain` whose URDF is in a folder."""
    (folder / "arm.urdf").write_text(chain(described))
    return arm_model(folder / "arm.urdf", **settings)


def recorded(joints, units, torque, n=1000, seed=0, name="a.csv", noise=1e-3):
    """A run of joints on smooth random paths; `torque(q=, v=, a=)` gives (n, nj)."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 100
    w = 2 * np.pi * np.array([0.2, 0.5, 0.9])
    c = 0.3 * rng.standard_normal((len(joints), 3))
    wave = np.outer(w, t)
    q, v, a = c @ np.sin(wave), c * w @ np.cos(wave), -c * w**2 @ np.sin(wave)
    tau, channels = torque(q=q.T, v=v.T, a=a.T), {}
    for i, (joint, unit) in enumerate(zip(joints, units, strict=True)):
        force = Channel(t, tau[:, i] + noise * rng.standard_normal(n), {"m": "N", "rad": "N m"}[unit])
        channels |= {f"q.{joint}": Channel(t, q[i], unit), f"tau.{joint}": force}
    return Run(name, channels)


SLIDE = [("slide", "prismatic", "1 0 0", "0 0 0")]
PENDULUM = [("swing", "revolute", "0 1 0", "0 0 0")]
DOUBLE = [*PENDULUM, ("elbow", "revolute", "0 1 0", "0.3 0 0")]
MIXED = [("lift", "prismatic", "0 0 1", "0 0 0"), ("turn", "continuous", "0 1 0", "0 0 0.2")]
