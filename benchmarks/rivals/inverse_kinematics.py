"""Inverse kinematics side by side on the same targets: armdyn, pink, pytracik, scipy; cold targets and a line.

    python benchmarks/rivals/inverse_kinematics.py [--robot baxter] [--targets 200] [--quick] [--json FILE]

pink and pytracik are optional: pip install pin-pink 'qpsolvers[daqp]' pytracik
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
from _timing import Claim, arguments, conclude, print_table, race, ratio, rounds_of  # isort: skip

from collections.abc import Callable
from time import perf_counter, process_time

import numpy as np
import pinocchio as pin
from _ik_peers import PEERS, RESTARTS_ITSELF, STARTS, TOLERANCE, MissingPeerError, Solve, error_of
from scipy.interpolate import CubicSpline

import urdf
from ik import build_line_table, default_table
from ik.plan import BranchPlanner
from ik.solver import IkSolver

TARGETS_ALONG_LINE = 1000
MANY = 5000  # cold targets at once, for the batch solver alone
JUDGED = 2.0  # times the tolerance: what the judge lets pass, as each peer measures a little differently


def cold_targets(robot: urdf.Robot, count: int) -> list[pin.SE3]:
    """Poses of the tool's frame at random postures."""
    rng, data = np.random.default_rng(2718), robot.model.createData()
    poses = []
    for q in rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.model.nv)):
        pin.framesForwardKinematics(robot.model, data, q)
        poses.append(data.oMf[robot.tool_frame_id].copy())
    return poses


def line_targets(robot: urdf.Robot, count: int) -> list[pin.SE3]:
    """Poses of the tool's frame along the robot's line."""
    line = robot.line
    turned = line.rotation @ robot.tool_offset
    return [pin.SE3(line.rotation, p - turned) for p in line.position(np.linspace(line.s_min, line.s_max, count))]


class OneByOne:
    """Solver that takes a list of targets one by one; `answers` are those of its last run."""

    def __init__(self, solve: Solve, targets: list[pin.SE3], starts: np.ndarray, follow: bool) -> None:
        self.solve, self.targets, self.starts, self.follow = solve, targets, starts, follow
        self.answers: list[np.ndarray | None] = []

    def __call__(self) -> float:
        """Solve them all; the seconds that it took."""
        started = perf_counter()
        self.answers = []
        before = self.starts[0]
        for target in self.targets:
            answer = None
            for start in [before] if self.follow else self.starts:
                answer = self.solve(target, start)
                if answer is not None:
                    break
            self.answers.append(answer)
            if self.follow and answer is not None:
                before = answer
        return perf_counter() - started


class Batch:
    """armdyn on the same list of targets, all at once."""

    def __init__(self, work: Callable[[], np.ndarray]) -> None:
        self.work = work
        self.answers: list[np.ndarray | None] = []

    def __call__(self) -> float:
        """Solve them all; the seconds that it took."""
        started = perf_counter()
        postures = self.work()
        seconds = perf_counter() - started
        self.answers = list(postures)
        return seconds


def success(robot: urdf.Robot, targets: list[pin.SE3], answers: list[np.ndarray | None]) -> float:
    """Share of targets that are reached by a posture within the limits, checked by Pinocchio."""
    data = robot.model.createData()
    good = [
        answer is not None
        and np.abs(error_of(robot, data, target, answer)).max() < JUDGED * TOLERANCE
        and robot.limits.margin(answer).min() > -1e-9
        for target, answer in zip(targets, answers, strict=True)
    ]
    return float(np.mean(good))


def roughness(robot: urdf.Robot, answers: list[np.ndarray | None]) -> tuple[float, float, float]:
    """Largest |q''| [rad/m^2], largest step [rad] and usable speed in the core [m/s] of postures on the line."""
    line = robot.line
    s = np.linspace(line.s_min, line.s_max, len(answers))
    kept = [index for index, answer in enumerate(answers) if answer is not None]
    q, s = np.array([answers[index] for index in kept]), s[kept]
    rate = np.diff(q, axis=0) / np.diff(s)[:, None]
    bend = np.diff(rate, axis=0) / np.diff(s)[1:, None]
    core = (s[1:] >= line.core[0]) & (s[:-1] <= line.core[1])
    speed = 1.0 / np.abs(rate[core] / robot.limits.velocity).max()
    return float(np.abs(bend).max()), float(np.abs(np.diff(q, axis=0)).max()), float(speed)


def peers(robot: urdf.Robot) -> dict[str, Solve]:
    """Solvers of the installed libraries by name; for the others, the command that installs them is printed."""
    found = {}
    for name, make in PEERS.items():
        try:
            found[name] = make(robot)
        except MissingPeerError as missing:
            print(f"{name} is left out: {missing}")
    return found


def main() -> int:
    """Run the comparisons, print the tables and check the claims; 1 where a claim is missed."""
    parser = arguments(__doc__.splitlines()[0], rounds=5, quick_rounds=1)
    parser.add_argument("--robot", default="baxter", help="a robot that has a line (baxter)")
    parser.add_argument("--targets", type=int, help="cold targets (200; 20 with --quick)")
    options = parser.parse_args()
    rounds, count = rounds_of(options), options.targets or (20 if options.quick else 200)
    robot, others = urdf.load(options.robot), {}
    others = peers(robot)
    results = {"robot": robot.name, "tolerance": TOLERANCE, "rounds": rounds}
    cold = race_cold(robot, others, count, rounds)
    many = batch_of_many(robot)
    line = race_line(robot, others, TARGETS_ALONG_LINE // (10 if options.quick else 1), rounds)
    results |= {"cold": cold, "many": many, "line": line}
    judged = None if options.quick else True
    claims = [
        Claim("random cold targets, 5000 at once: at least 7,000 per second of one core", f"{many['rate']:.0f}",
              judged and many["rate"] >= 7000),
        Claim("of which at least 99.5 % are reached", f"{100 * many['success']:.2f} %", many["success"] >= 0.995),
        Claim("targets on the line: at least 20,000 per second", f"{line['armdyn']['rate']:.0f}",
              judged and line["armdyn"]["rate"] >= 20000),
        Claim("all of them reached", f"{100 * line['armdyn']['success']:.2f} %", line["armdyn"]["success"] == 1.0),
    ]  # fmt: skip
    return conclude(claims, results, options.json)


def race_cold(robot: urdf.Robot, others: dict[str, Solve], count: int, rounds: int) -> dict[str, dict[str, object]]:
    """Results on unrelated targets: every solver starts from home, then up to 19 random postures, equal for all."""
    targets = cold_targets(robot, count)
    starts = np.random.default_rng(3141).uniform(robot.limits.lower, robot.limits.upper, (STARTS, robot.model.nv))
    starts[0] = robot.home
    rotation, position = _arrays(robot, targets)
    solver = IkSolver(robot)
    contenders: dict[str, OneByOne | Batch] = {
        "armdyn": Batch(lambda: solver.solve(rotation, position, tolerance=TOLERANCE).q)
    }
    for name, solve in others.items():
        contenders[name] = OneByOne(solve, targets, starts[:1] if name in RESTARTS_ITSELF else starts, follow=False)
    seconds = race(contenders, rounds)
    rows, table = [], {}
    for name, contender in contenders.items():
        slower = ratio(seconds, name, "armdyn")
        share = success(robot, targets, contender.answers)
        rate = count / float(np.median(seconds[name]))
        rows.append([name, f"{rate:.0f}", str(slower), f"{100 * share:.1f}"])
        table[name] = {"rate": rate, "time_ratio": slower, "success": share}
    print_table(f"{count} unrelated targets", ["solver", "targets/s", "time / armdyn's", "reached [%]"], rows)
    return table


def batch_of_many(robot: urdf.Robot) -> dict[str, float]:
    """Results of the batch solver on many targets at once."""
    targets = cold_targets(robot, MANY)
    rotation, position = _arrays(robot, targets)
    solver = IkSolver(robot)
    batch = Batch(lambda: solver.solve(rotation, position, tolerance=TOLERANCE).q)
    batch()
    seconds = []
    for _ in range(3):
        started = process_time()
        batch()
        seconds.append(process_time() - started)
    return {"rate": MANY / min(seconds), "success": success(robot, targets, batch.answers)}


def race_line(robot: urdf.Robot, others: dict[str, Solve], count: int, rounds: int) -> dict[str, dict[str, object]]:
    """Results on targets along the line; the peers start from the posture before, armdyn from its planned branch."""
    targets = line_targets(robot, count)
    line, planner = robot.line, BranchPlanner(robot, robot.line)
    s, chain = np.linspace(line.s_min, line.s_max, count), planner.chain
    branch, guess = planner.plan()
    course = CubicSpline(planner.s, guess)
    whole = timed_build(robot)

    def planned_first() -> np.ndarray:
        branch, guess = planner.plan()
        return branch.solve(chain, line, s, CubicSpline(planner.s, guess)(s))[0]

    first = default_table(robot).posture(line.s_min).q
    contenders: dict[str, OneByOne | Batch] = {
        "armdyn": Batch(lambda: branch.solve(chain, line, s, course(s))[0]),
        "armdyn, plan counted": Batch(planned_first),
    }
    for name, solve in others.items():
        contenders[name] = OneByOne(solve, targets, first[None], follow=True)
    seconds = race(contenders, rounds)
    own = roughness(robot, list(contenders["armdyn"].answers) or [])
    rows, table = [], {}
    for name, contender in contenders.items():
        slower, share = ratio(seconds, name, "armdyn"), success(robot, targets, contender.answers)
        bend, step, speed = roughness(robot, contender.answers)
        rate = count / float(np.median(seconds[name]))
        rows.append([name, f"{rate:.0f}", str(slower), f"{100 * share:.1f}", f"{bend / own[0]:.1f}",
                     f"{step / own[1]:.2f}", f"{speed / own[2]:.2f}"])  # fmt: skip
        table[name] = {
            "rate": rate, "time_ratio": slower, "success": share, "bend": bend, "step": step, "speed": speed
        }  # fmt: skip
    headings = ["solver", "targets/s", "time / armdyn's", "reached [%]", "bend", "step", "usable speed"]
    print_table(f"{count} targets along the line; bend, step and usable speed over armdyn's", headings, rows)
    print("armdyn plans its branch once per line; the peers start each target from the posture before.")
    print(f"armdyn's plan and table of {TARGETS_ALONG_LINE} and more nodes, once per robot: {whole:.2f} s")
    return table


def timed_build(robot: urdf.Robot) -> float:
    """Duration of building a whole table [s]."""
    started = perf_counter()
    build_line_table(robot)
    return perf_counter() - started


def _arrays(robot: urdf.Robot, targets: list[pin.SE3]) -> tuple[np.ndarray, np.ndarray]:
    """Targets of the tool point: orientations (k, 3, 3) and positions (k, 3) [m]."""
    rotation = np.array([target.rotation for target in targets])
    position = np.array([target.translation + target.rotation @ robot.tool_offset for target in targets])
    return rotation, position


if __name__ == "__main__":
    raise SystemExit(main())
