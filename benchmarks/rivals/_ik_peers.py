"""Other libraries' inverse kinematics behind one function each: a posture for a target and a start, or None."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import OptimizeResult, least_squares

import urdf

Solve = Callable[[pin.SE3, np.ndarray], np.ndarray | None]
"""Function of the tool frame's pose and a start posture (n,) that returns a posture (n,) or None."""
TOLERANCE = 1e-6  # largest error of every component [m], [rad]
STARTS = 20  # largest number of starts for a target without a nearby posture
ITERATIONS = 100  # largest number of pink's steps from one start
TRACIK_SECONDS = 0.05  # longest time for a target [s]; trac-ik restarts by itself


class MissingPeerError(Exception):
    """A library is not installed; the message gives the command that installs it."""


def error_of(robot: urdf.Robot, data: pin.Data, target: pin.SE3, q: np.ndarray) -> np.ndarray:
    """Remaining translation [m] and rotation [rad] from a posture to the target (6,)."""
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.tool_frame_id]
    return np.concatenate((target.translation - pose.translation, pin.log3(pose.rotation.T @ target.rotation)))


def scipy_solver(robot: urdf.Robot) -> Solve:
    """Inverse kinematics by scipy's bounded least squares (dogbox, faster here than trf) on Pinocchio's Jacobian."""
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
    """Inverse kinematics by pink's differential steps up to the target, with joint limits; daqp solves the QP."""
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
    """Inverse kinematics by trac-ik: KDL's Newton method and NLopt's SQP in parallel, with its own restarts."""
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
