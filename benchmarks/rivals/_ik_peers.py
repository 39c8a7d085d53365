"""Other libraries' inverse kinematics behind one function each: a posture for a target and a start, or None."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import OptimizeResult, least_squares

import urdf

Solve = Callable[[pin.SE3, np.ndarray], np.ndarray | None]
"""Takes the pose of the tool's frame and a start (n,), gives a posture (n,) or None."""
TOLERANCE = 1e-6  # m and rad, of every component
STARTS = 20  # a cold target may take
ITERATIONS = 100  # of pink's steps from one start
TRACIK_SECONDS = 0.05  # a target may take; trac-ik restarts by itself


class MissingPeerError(Exception):
    """A peer that is not installed; the message says how to get it."""


def error_of(robot: urdf.Robot, data: pin.Data, target: pin.SE3, q: np.ndarray) -> np.ndarray:
    """Shift [m] and turn [rad] left to the target, (6,)."""
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.tool_frame_id]
    return np.concatenate((target.translation - pose.translation, pin.log3(pose.rotation.T @ target.rotation)))


def scipy_solver(robot: urdf.Robot) -> Solve:
    """Bounded least squares (dogbox, faster here than trf) on Pinocchio's Jacobian."""
    data, lower, upper = robot.model.createData(), robot.limits.lower, robot.limits.upper

    def residual(q: np.ndarray, target: pin.SE3) -> np.ndarray:
        pin.framesForwardKinematics(robot.model, data, q)
        return pin.log6(target.actInv(data.oMf[robot.tool_frame_id])).vector

    def jacobian(q: np.ndarray, target: pin.SE3) -> np.ndarray:
        local = pin.computeFrameJacobian(robot.model, data, q, robot.tool_frame_id, pin.ReferenceFrame.LOCAL)
        return pin.Jlog6(target.actInv(data.oMf[robot.tool_frame_id])) @ local

    def stop_when_there(intermediate_result: OptimizeResult) -> None:
        if np.abs(intermediate_result.fun).max() < TOLERANCE:
            raise StopIteration

    def solve(target: pin.SE3, start: np.ndarray) -> np.ndarray | None:
        inside = np.clip(start, lower + 1e-9, upper - 1e-9)
        answer = least_squares(
            residual, inside, jacobian, bounds=(lower, upper), method="dogbox", args=(target,), callback=stop_when_there
        )
        return np.asarray(answer.x) if np.abs(answer.fun).max() < TOLERANCE else None

    return solve


def pink_solver(robot: urdf.Robot) -> Solve:
    """Differential inverse kinematics stepped until it arrives, with its joint limits; QP by daqp."""
    try:
        import pink
        from pink.limits import ConfigurationLimit
        from pink.tasks import FrameTask
    except ImportError as error:
        raise MissingPeerError("pink is not installed: pip install pin-pink 'qpsolvers[daqp]'") from error
    task = FrameTask(robot.tool_frame, position_cost=1.0, orientation_cost=1.0, lm_damping=1e-3)
    data, limits = robot.model.createData(), [ConfigurationLimit(robot.model)]

    def solve(target: pin.SE3, start: np.ndarray) -> np.ndarray | None:
        configuration = pink.Configuration(robot.model, data, start, copy_data=False)
        task.set_target(target)
        for _ in range(ITERATIONS):
            if np.abs(task.compute_error(configuration)).max() < TOLERANCE:
                return np.array(configuration.q)
            step = pink.solve_ik(configuration, [task], 1.0, solver="daqp", limits=limits, safety_break=False)
            configuration.integrate_inplace(step, 1.0)
        return None

    return solve


def tracik_solver(robot: urdf.Robot) -> Solve:
    """trac-ik: KDL's Newton method and NLopt's SQP side by side, restarts of its own."""
    try:
        from trac_ik import TracIK
    except ImportError as error:
        raise MissingPeerError("pytracik is not installed: pip install pytracik") from error
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        file.write_text(robot.urdf_xml)
        full = pin.buildModelFromXML(robot.urdf_xml)
        base = full.frames[full.getFrameId("universe") + 1].name
        solver = TracIK(base, robot.tool_frame, str(file), timeout=TRACIK_SECONDS, epsilon=TOLERANCE)
    if solver.dof != robot.model.nv:
        raise MissingPeerError(
            f"pytracik sees {solver.dof} joints between {base} and {robot.tool_frame}, the arm has fewer"
        )

    def solve(target: pin.SE3, start: np.ndarray) -> np.ndarray | None:
        answer = solver.ik(target.translation, target.rotation, start)
        return None if answer is None else np.asarray(answer)

    return solve


PEERS: dict[str, Callable[[urdf.Robot], Solve]] = {
    "pink": pink_solver,
    "pytracik": tracik_solver,
    "scipy": scipy_solver,
}
RESTARTS_ITSELF = ("pytracik",)
