"""Is a retimed path feasible, and how much longer than the optimum of toppra?

    pip install toppra
    python benchmarks/retime.py [--trajectories 50] [--json FILE]

Random paths of four arms, 1,000 points each, as described and with friction (a model of theirs). Each is retimed under
limits of speed and torque, and under those of acceleration and jerk besides. Then its middle part is, with velocities
at both ends, of a tenth to four tenths of a speed limit, where toppra finds a speed. Feasible is what a check says:
differences of the written positions, and MuJoCo's or Pinocchio's torques. The optimum is that of toppra (Pham & Pham,
IEEE Trans. Robotics 34, 2018) with limits of speed and torque, on the same spline. Wanted: all feasible, durations at
most 1.05 of toppra's, at most 1.25 with jerk, and 0.5 s of processor time.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
import _hidden_table as hidden_table  # isort: skip

import argparse
import json
import time
import warnings
from typing import Any

import numpy as np
import pinocchio as pin
import toppra
import toppra.algorithm
import toppra.constraint

from armdyn.errors import TaskFailedError
from pipeline.motion.averaged import JointPath, RetimingLimits
from pipeline.motion.retime import retimed
from pipeline.motion.trajectory import AT_REST, EndVelocities, JointTrajectory
from urdf.robot import Array, Limits, Robot

worlds = hidden_table.generator("mujoco_arm")
plant = sys.modules[worlds.compiled.__module__]
ROBOTS, POINTS, SECONDS, NODES = ("z1", "xarm7", "ur5", "panda"), 1000, 6.0, 500
FRICTION = (0.0, 0.15)  # of the torque limit
LONGEST, LONGEST_WITH_JERK, CPU = 1.05, 1.25, 0.5
KINDS, SPEED, MIDDLE = ("", "_jerk", "_moving", "_moving_jerk"), (0.1, 0.4), slice(150, 850)


class Arm:
    """Rigid bodies with Coulomb friction."""

    def __init__(self, robot: Robot, friction: Array) -> None:
        self.robot, self.friction, self.model = robot, friction, pin.Model(robot.model)
        self.model.damping = np.zeros(self.model.nv)
        self.data = self.model.createData()

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """(n, joints) N m."""
        rows = [pin.rnea(self.model, self.data, *row) for row in zip(q, v, a, strict=True)]
        return np.array(rows) + self.friction * np.sign(v)

    def band(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """The same, without uncertainty."""
        return self.torque(q, v, a), np.zeros_like(q)


def broken(arm: Arm, motion: JointTrajectory, jerk: bool) -> list[str]:
    """Limits that the samples and their differences break, by more than a thousandth."""
    limits, h = arm.robot.limits, np.diff(motion.time)[:, None]
    used = {
        "position": np.maximum(motion.q - limits.upper, limits.lower - motion.q) / (limits.upper - limits.lower) + 1.0,
        "velocity": np.abs(motion.v) / limits.velocity,
        "mean velocity": np.abs(np.diff(motion.q, axis=0)) / h / limits.velocity,
        "torque": np.abs(arm.torque(motion.q, motion.v, motion.a)) / limits.effort,
    }
    if jerk:
        used |= {
            "acceleration": np.abs(motion.a) / limits.acceleration,
            "mean acceleration": np.abs(np.diff(motion.v, axis=0)) / h / limits.acceleration,
            "jerk": np.abs(np.diff(motion.a, axis=0)) / h / limits.jerk,
        }
    # Velocity and acceleration must be those of the positions; a jump d of an acceleration within h s lets the
    # mean velocity differ by up to d h / 8 from that of its ends.
    middle = (motion.v[1:] + motion.v[:-1]) / 2 - np.diff(motion.q, axis=0) / h
    jumps = np.abs(np.diff(motion.a, axis=0)) * h / 8
    used["columns"] = np.maximum(np.abs(middle) - jumps, 0.0) / limits.velocity * 20.0
    return [name for name, share in used.items() if share.max() > 1.001]


def ends_of(velocity: Array, limits: Limits, rng: np.random.Generator) -> EndVelocities:
    """Velocities at both ends of a part of a motion, whose own ones (n, joints) have their directions.

    The direction of a spline without a bend at its ends would be another, and bend it within one interval.
    """
    ways = velocity[0], velocity[-1]
    return EndVelocities(*(rng.uniform(*SPEED) * way / (np.abs(way) / limits.velocity).max() for way in ways))


def optimum(arm: Arm, path: JointPath) -> float:
    """Duration by toppra, s; nan where it finds no speed."""
    limits, at = arm.robot.limits, path.spline.x
    clamped = [(1, path.spline(s, 1)) for s in (0.0, path.length)]
    spline = toppra.SplineInterpolator(at, path.spline(at), bc_type=clamped if any(path.speeds) else "natural")
    both = [np.c_[-bound, bound] for bound in (limits.velocity, limits.effort)]

    def rigid(q: Array, v: Array, a: Array) -> Array:
        return np.asarray(pin.rnea(arm.model, arm.data, q, v, a))

    found = toppra.algorithm.TOPPRA(
        [
            toppra.constraint.JointVelocityConstraint(both[0]),
            toppra.constraint.JointTorqueConstraint(rigid, both[1], arm.friction, discretization_scheme=1),
        ],
        spline,
        gridpoints=np.linspace(0.0, at[-1], NODES + 1),
        solver_wrapper="seidel",
    ).compute_parameterization(*path.speeds)[1]
    return np.nan if found is None else float(np.sum(2.0 * at[-1] / NODES / (found[1:] + found[:-1])))


def examine(name: str, count: int) -> dict[str, Any]:
    """Counts of one arm."""
    robot, rng = worlds.robot_of(name), np.random.default_rng(ROBOTS.index(name))
    row: dict[str, Any] = {"robot": name, "cpu": []}
    row |= {f"{what}{kind}": 0 if what == "feasible" else [] for what in ("feasible", "ratio") for kind in KINDS}
    drawn, moving = 0, np.random.default_rng([ROBOTS.index(name), 1])
    while drawn < count:
        arm = Arm(robot, robot.limits.effort * rng.uniform(*FRICTION, len(robot.joint_names)))
        q, v, _ = plant.Path.drawn(rng, robot, (0.1, 0.5), SECONDS).at(np.linspace(0.0, SECONDS, POINTS))
        path = JointPath(q, robot.limits.velocity)
        best = optimum(arm, path)
        if not np.isfinite(best):
            continue
        drawn += 1
        inner = q[MIDDLE]
        ends = ends_of(v[MIDDLE], robot.limits, moving)
        quick = optimum(arm, JointPath(inner, robot.limits.velocity, ends))
        for key in KINDS:
            points, of, least = (inner, ends, quick) if "moving" in key else (q, AT_REST, best)
            jerk = "jerk" in key
            if not np.isfinite(least):
                continue
            begun = time.process_time()
            try:
                given = RetimingLimits(robot.limits, robot.limits.effort, jerk)
                motion = retimed(points, robot.joint_names, given, arm.band, of)
            except TaskFailedError as refusal:
                print(name, key, refusal)
                continue
            row["cpu"].append(time.process_time() - begun)
            wrong = broken(arm, motion, jerk)
            for v, at in ((of.start, 0), (of.end, -1)):
                wrong += [] if v is None or np.allclose(motion.v[at], v, atol=1e-6) else ["velocity at an end"]
            row[f"feasible{key}"] += not wrong
            row[f"ratio{key}"].append(float(motion.time[-1]) / least)
            if wrong:
                print(name, wrong)
    return row


def main() -> int:
    """Print a line for each arm, and whether what is wanted was reached."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectories", type=int, default=50)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    toppra.setup_logging("ERROR")
    rows = [examine(name, given.trajectories) for name in ROBOTS]
    for row in rows:
        for kind in KINDS:
            ratio, what = row[f"ratio{kind}"] or [np.nan], kind.replace("_", " ")
            print(
                f"{row['robot']:6s}{what:13s} feasible {row[f'feasible{kind}']} of {len(ratio)}; over "
                f"toppra {np.median(ratio):.3f}, largest {max(ratio):.3f}; processor {max(row['cpu']):.2f} s at most"
            )
    if given.json is not None:
        given.json.write_text(json.dumps(rows))
    feasible = all(row[f"feasible{key}"] == len(row[f"ratio{key}"]) for row in rows for key in KINDS)
    feasible = feasible and all(len(row["ratio"]) == len(row["ratio_jerk"]) == given.trajectories for row in rows)
    quick = max(max(row["cpu"]) for row in rows) <= CPU
    short = all(max(row["ratio"]) <= LONGEST and max(row["ratio_jerk"]) <= LONGEST_WITH_JERK for row in rows)
    return 0 if feasible and quick and short else 1


if __name__ == "__main__":
    sys.exit(main())
