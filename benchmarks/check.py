"""Is `check --model` right about arms that MuJoCo simulates with their true friction, load and drives?

    python benchmarks/check.py [--trajectories 50] [--json FILE]

Four arms of `tests/worlds/mujoco_arm.py` have frictions, rotors, a load and offsets that their description lacks. Each
is repaired from its recordings. Then random trajectories are as fast as makes the largest share of a torque limit
about 1, and the check says whether they are feasible. The truth is MuJoCo's inverse dynamics with what is hidden.
Wanted: at least 97 % of the verdicts right, and none "feasible" where a limit is broken by more than its band.
Then the motion of four arms with position drives (`tests/worlds/mujoco_servo_arm.py`) in closed loop: the model has the
true values, and what it predicts of a run is compared with what MuJoCo recorded.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
import _hidden_table as hidden_table  # isort: skip

import argparse
import json
import time
import warnings
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from armdyn.arm.model import arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.model_file import ModelFile, read_model_file, write_model_file
from pipeline.motion.feasibility import CheckSettings, check_joints
from pipeline.motion.feasibility.as_modelled import ModelledArm
from pipeline.motion.trajectory import JointTrajectory

sys.path.append(str(Path(__file__).resolve().parent / "hidden"))
from mujoco_arm import true_model  # isort: skip

worlds, servo_worlds = hidden_table.generator("mujoco_arm"), hidden_table.generator("mujoco_servo_arm")
plant = sys.modules[worlds.compiled.__module__]
SEEDS = (0, 1, 2, 3)  # z1, xarm7, ur5, panda
SERVO_SEEDS = (0, 1, 2, 3)  # the same with position drives
SECONDS, RATE, REACHED = 4.0, 100.0, (0.6, 1.4)
WANTED, HALVINGS = 0.97, 30


def repaired(seed: int, folder: Path) -> tuple[Any, ModelledArm]:
    """A simulated arm, and the arm of the model file that a repair writes."""
    arm = worlds.generate(seed)
    description = folder / f"{seed}.urdf"
    description.write_text(arm.description)
    given = arm_model(urdf=description, joints=arm.joints)
    *training, held_out, _ = arm.runs
    study = CheckedStudy.of(given, training, [held_out])
    found = study.repair()
    file = folder / f"{seed}.toml"
    history = found.history
    write_model_file(file, ModelFile(found.model, given.file_entries(folder), history))
    return arm, ModelledArm.of_file(read_model_file(file))


def truth(arm: Any, motion: JointTrajectory) -> np.ndarray:
    """(n, joints) torques of MuJoCo's bodies with what is hidden, N m."""
    dry = [one for one in arm.hidden if one.effect == "joint_coulomb_friction"]
    model = plant.compiled(arm.exact, arm.joints, tuple(one for one in arm.hidden if one not in dry))
    found = plant.rigid_torques(model, arm.joints, (motion.q, motion.v, motion.a))
    for one in dry:
        j = arm.joints.index(one.joint)
        found[:, j] += one.values["torque"] * np.sign(motion.v[:, j])
    return np.asarray(found)


def drawn(rng: np.random.Generator, arm: Any, effort: np.ndarray) -> JointTrajectory:
    """A random trajectory of which the largest share of a torque limit is drawn, as far as its speed decides."""
    robot, wanted, low, high = worlds.robot_of(arm.robot), rng.uniform(*REACHED), 0.05, 20.0
    t = np.arange(0.0, SECONDS, 1 / RATE)
    q, v, a = plant.Path.drawn(rng, robot, (0.1, 0.5), SECONDS).at(t)
    for _ in range(HALVINGS):
        k = float(np.sqrt(low * high))
        motion = JointTrajectory(t / k, q, v * k, a * k * k, arm.joints)
        low, high = (k, high) if (np.abs(truth(arm, motion)) / effort).max() < wanted else (low, k)
    return motion


def examine(seed: int, count: int, folder: Path) -> dict[str, Any]:
    """Counts of one arm."""
    arm, modelled = repaired(seed, folder)
    rng, effort = np.random.default_rng([seed, 7]), modelled.limit
    row = {"robot": arm.robot, "right": 0, "by_description": 0, "unsafe": 0, "feasible": 0, "cpu": 0.0}
    for _ in range(count):
        motion = drawn(rng, arm, effort)
        excess = np.abs(truth(arm, motion)) - effort
        said = {}
        for name, model in (("right", modelled), ("by_description", None)):
            begun = time.process_time()
            settings = CheckSettings(collision=False, min_singular_value=0.0, modelled=model)
            broken = check_joints(modelled.model.robot, motion, settings).violations
            row["cpu"] += (time.process_time() - begun) / count if model else 0.0
            said[name] = not any(one.limit == "torque" for one in broken)
            row[name] += said[name] == (excess.max() <= 0.0)
        row["feasible"] += excess.max() <= 0.0
        _, half = modelled.torques(motion.q, motion.v, motion.a)
        row["unsafe"] += said["right"] and bool(np.any(excess > half))
    return row


def tracking(seed: int, folder: Path) -> tuple[str, float, float]:
    """Robot, rms distance of MuJoCo's servo arm from its commands, and of the predicted motion from MuJoCo's, rad."""
    arm, file = servo_worlds.generate(seed), folder / f"servo {seed}.urdf"
    file.write_text(arm.exact)
    model = true_model(arm_model(urdf=file, joints=arm.joints), arm.hidden).with_drives(arm.drives)
    run = arm.runs[-1]
    told = [run.channels[f"q_cmd.{joint}"] for joint in arm.joints]
    time_, q = told[0].time, np.column_stack([channel.value for channel in told])
    moved = (run.channels[f"q.{joint}"] for joint in arm.joints)
    away = np.column_stack([np.interp(time_, channel.time, channel.value) for channel in moved]) - q
    motion = JointTrajectory(time_, q, np.gradient(q, time_, axis=0), np.zeros_like(q), arm.joints)
    followed = ModelledArm(model, np.zeros(len(arm.joints))).followed(motion)
    assert followed is not None
    settled = slice(len(time_) // 20, None)
    sizes = (float(np.sqrt(np.mean(part[settled] ** 2))) for part in (away, followed.error - away))
    return arm.robot, *sizes


def main() -> int:
    """Print a line for each arm, and whether what is wanted was reached."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectories", type=int, default=50)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    with TemporaryDirectory() as folder:
        for seed in SEEDS:
            rows.append(examine(seed, given.trajectories, Path(folder)))
            row = rows[-1]
            print(
                f"{row['robot']:6s} right {row['right']} of {given.trajectories} ({row['feasible']} feasible), by the "
                f"description alone {row['by_description']}; feasible beyond the band {row['unsafe']}; "
                f"{1e3 * row['cpu']:.0f} ms a check",
                flush=True,
            )
        for seed in SERVO_SEEDS:
            robot, away, error = tracking(seed, Path(folder))
            print(
                f"{robot:6s} servos are {1e3 * away:.1f} mrad from their commands, predicted within {1e3 * error:.2f}"
            )
    total = len(SEEDS) * given.trajectories
    share, unsafe = sum(row["right"] for row in rows) / total, sum(row["unsafe"] for row in rows)
    print(f"verdicts right {100 * share:.1f} %, feasible beyond the band {unsafe}")
    if given.json is not None:
        given.json.write_text(json.dumps(rows, default=float))
    return 0 if share >= WANTED and not unsafe else 1


if __name__ == "__main__":
    sys.exit(main())
