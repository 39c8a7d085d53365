"""Where the string's upper end is on its line, from the measured joints."""

import numpy as np
import pinocchio as pin

from urdf import Robot


class LineSensor:
    """Forward kinematics of the attachment point, expressed along the robot's line."""

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._frame = robot.model.getFrameId(robot.tool_frame)
        self._offset, self._line = np.asarray(robot.tool_offset), robot.line

    def locate(self, q: np.ndarray) -> tuple[float, float]:
        """Coordinate along the line and height above it, m, of a posture (n,)."""
        pin.forwardKinematics(self._model, self._data, q)
        pose = pin.updateFramePlacement(self._model, self._data, self._frame)
        away = pose.translation + pose.rotation @ self._offset - self._line.origin
        along = float(away @ self._line.direction)
        return along, float(away[2] - along * self._line.direction[2])
