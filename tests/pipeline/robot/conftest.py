"""A Baxter, a posture on its line, and a way to move along it that uses neither `ik` nor `armdyn`."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline

import urdf
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot
from pipeline.robot.truth import GripperTruth, LoadTruth

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LineMotion:
    """Postures along the line as a spline of s."""

    robot: urdf.Robot
    spline: CubicSpline

    def joints(self, s: float, v: float, a: float) -> tuple[Vector, Vector, Vector]:
        dq, ddq = self.spline(s, 1), self.spline(s, 2)
        return self.spline(s), dq * v, dq * a + ddq * v**2

    def tool(self, q: Vector) -> Vector:
        """The string's upper end (3,) by Pinocchio."""
        return np.array(self.robot.tool_pose(q).translation)

    def follow(
        self, plant: SimulatedRobot, path: Callable[[float], tuple[float, float, float]], seconds: float
    ) -> list[tuple[float, float, GripperTruth, LoadTruth]]:
        """Command s(t), v(t), a(t) at 100 Hz; returns (time, s commanded, gripper truth, load truth) every 10 ms."""
        rows = []
        for _ in range(round(seconds / 0.01)):
            s, v, a = path(plant.time)
            plant.command(*self.joints(s, v, a))
            rows.append((plant.time, s, plant.gripper_truth(), plant.load_truth()))
            plant.advance(0.01)
        return rows


@pytest.fixture(scope="session")
def baxter() -> urdf.Robot:
    return urdf.load("baxter")


@pytest.fixture(scope="session")
def line_motion(baxter: urdf.Robot) -> LineMotion:
    nodes = np.linspace(-0.16, 0.16, 33)
    postures = np.zeros((len(nodes), 7))
    middle = len(nodes) // 2
    postures[middle] = _solve(baxter, 0.0, np.array(baxter.home))
    for i in range(middle + 1, len(nodes)):
        postures[i] = _solve(baxter, nodes[i], postures[i - 1])
    for i in reversed(range(middle)):
        postures[i] = _solve(baxter, nodes[i], postures[i + 1])
    return LineMotion(baxter, CubicSpline(nodes, postures))


@pytest.fixture(scope="session")
def q_start(line_motion: LineMotion) -> Vector:
    return line_motion.joints(0.0, 0.0, 0.0)[0]


def _solve(robot: urdf.Robot, s: float, q: Vector) -> Vector:
    """Posture nearest to q whose tool point is at s on the line (Newton, minimum norm)."""
    model, data = robot.model, robot.model.createData()
    offset = pin.SE3(np.eye(3), np.array(robot.tool_offset))
    target = pin.SE3(np.array(robot.line.rotation), np.array(robot.line.position(s)))
    for _ in range(50):
        error = pin.log6(robot.tool_pose(q).actInv(target)).vector
        if np.linalg.norm(error) < 1e-12:
            return q
        jacobian = pin.computeFrameJacobian(model, data, q, robot.tool_frame_id, pin.LOCAL)
        q = q + np.linalg.pinv(offset.toActionMatrixInverse() @ jacobian) @ error
    raise AssertionError(f"no posture for s = {s}")


@pytest.fixture(scope="session")
def still_pendulum(baxter: urdf.Robot, q_start: Vector) -> Callable[..., SimulatedRobot]:
    """A plant with an arm that does not move and nothing else uncertain: a pendulum with a fixed pivot."""

    def make(angle: float, hidden: dict[str, float | None] | None = None, **changes: object) -> SimulatedRobot:
        settings = replace(PlantSettings.exact(), rigid_arm=True, start_angle=angle, box=None, **changes)
        return SimulatedRobot(baxter, q_start, settings, hidden)

    return make


@dataclass(frozen=True)
class Swing:
    """History of a plant as seen from the pivot: angle in the plane of the line, angle across, distance."""

    time: Vector
    angle: Vector
    across: Vector
    distance: Vector
    tension: Vector

    @staticmethod
    def of(plant: SimulatedRobot) -> "Swing":
        history = plant.history()
        string = history.load - history.pivot
        # Baxter's line runs along y; the load is at s - l sin(angle), and -x is to the left of the line.
        return Swing(
            history.time,
            np.arctan2(-string[:, 1], -string[:, 2]),
            np.arctan2(-string[:, 0], -string[:, 2]),
            np.linalg.norm(string, axis=1),
            history.tension,
        )


@pytest.fixture(scope="session")
def watch() -> Callable[[SimulatedRobot, float], Swing]:
    """Let a plant run for some seconds and see how its load swings."""

    def run(plant: SimulatedRobot, seconds: float) -> Swing:
        plant.advance(seconds)
        return Swing.of(plant)

    return run
