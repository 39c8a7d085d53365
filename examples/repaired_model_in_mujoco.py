"""A repaired model in a MuJoCo simulation: computed torque on a UR5 that carries 1.5 kg it was not told of.

The plant is MuJoCo's UR5 with friction and payload. One controller has the URDF, the other one what armdyn found.
"""

import mujoco
import numpy as np
from arm_from_urdf import read

import armdyn
from pipeline.exports.mujoco_file import mujoco_text

STEP, SECONDS = 0.002, 3.0
STIFFNESS, DAMPING = 100.0, 20.0
"""1/s^2 and 1/s, of the error."""


def reference(t: float, home: np.ndarray) -> list[np.ndarray]:
    """Position, velocity and acceleration of a smooth motion about a posture."""
    w, size = 2.0 * np.pi / 3.0, 0.4
    return [
        home + size * (1 - np.cos(w * t)),
        size * w * np.sin(w * t) + 0 * home,
        size * w**2 * np.cos(w * t) + 0 * home,
    ]


def tracked(plant: mujoco.MjModel, known: mujoco.MjModel, home: np.ndarray) -> float:
    """Largest error of a joint [rad] when the inverse dynamics of `known` drive the `plant`."""
    real, inverse, worst = mujoco.MjData(plant), mujoco.MjData(known), 0.0
    real.qpos[:] = home
    for step in range(round(SECONDS / STEP)):
        q, v, a = reference(step * STEP, home)
        error = q - real.qpos
        inverse.qpos[:], inverse.qvel[:] = real.qpos, real.qvel
        inverse.qacc[:] = a + STIFFNESS * error + DAMPING * (v - real.qvel)
        mujoco.mj_inverse(known, inverse)
        real.qfrc_applied[:] = inverse.qfrc_inverse
        mujoco.mj_step(plant, real)
        worst = max(worst, float(np.abs(error).max()))
    return worst


def main() -> tuple[float, float]:
    """Largest tracking errors with the URDF and with the repaired model, rad."""
    runs, described = [read("sweep_1"), read("sweep_2")], armdyn.arm.arm_model(robot="ur5")
    richer = described.with_effect(armdyn.CATALOGUE["payload"].on("wrist_3_joint"))
    for name in ("joint_viscous_friction", "joint_coulomb_friction"):
        richer = richer.with_effect(armdyn.CATALOGUE[name])
    urdf, repaired = (mujoco.MjModel.from_xml_string(mujoco_text(m)[0]) for m in (described, armdyn.fit(richer, runs)))
    repaired.opt.timestep = STEP
    home = runs[0].channels["q.elbow_joint"].value[0] * np.zeros(6) + [0.0, -1.5, 1.2, -1.0, -1.5, 0.0]
    errors = tracked(repaired, urdf, home), tracked(repaired, repaired, home)
    print("largest tracking error: {:.4f} rad with the URDF, {:.4f} rad with the repaired model".format(*errors))
    return errors


if __name__ == "__main__":
    main()
