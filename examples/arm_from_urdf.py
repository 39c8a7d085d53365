"""An arm from its URDF and recordings of somebody else's logger: fit friction and the payload, predict another motion.

The recordings are simulated: a UR5 that carries 1.5 kg and has friction, neither of which its URDF knows.
"""

from pathlib import Path

import numpy as np

import armdyn

HERE = Path(__file__).parent
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


def read(name: str) -> armdyn.Run:
    """A run from a table of other names and units: columns of angles in degrees, then of torques."""
    table = np.loadtxt(HERE / f"ur5/{name}.csv", delimiter=",", skiprows=1)
    count = len(JOINTS)
    return armdyn.Run.from_arrays(
        1e-3 * table[:, 0],
        {"q": table[:, 1 : count + 1], "tau": table[:, count + 1 :]},
        joints=[f"{joint}_joint" for joint in JOINTS],
        units={"q": "deg"},
        name=name,
    )


def main() -> dict[str, float]:
    """Fit, and compare the errors on a motion of another kind; total over the joints, N m."""
    sweeps, work = [read("sweep_1"), read("sweep_2")], [read("pick_and_place")]
    described = armdyn.arm.arm_model(robot="ur5")  # or urdf="my_robot.urdf"

    # Effects come from the catalogue; `on` says where, else they act on every joint.
    better = described
    for name in ("joint_viscous_friction", "joint_coulomb_friction"):
        better = better.with_effect(armdyn.CATALOGUE[name])
    better = better.with_effect(armdyn.CATALOGUE["payload"].on("wrist_3_joint"))

    errors = {}
    for name, model in (("as described", described), ("with friction and payload", better)):
        found = armdyn.compare(model, sweeps, work)
        errors[name] = float(np.hypot.reduce([channel.held_out_rmse for channel in found.channels.values()]))
        print(f"{name}: {errors[name]:.3g} N m on the motion that was not fitted")
    payload = found.parameters["payload.mass[wrist_3_joint]"]
    print(f"payload: {payload.value:.4f} ± {payload.std:.4f} kg")
    return errors


if __name__ == "__main__":
    main()
