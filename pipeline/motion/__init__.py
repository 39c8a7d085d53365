"""Motion along the line: smoothing, the finish over the box, and checks of every motion's feasibility.

Everything here works on the line coordinate ``s`` [m] of the tool (+ = the robot's left), so that no motion can leave
the line, and reaches the joints through the table of `ik`.
"""

from pipeline.motion.finish import finish_over_box
from pipeline.motion.gate import Gate, LineGate
from pipeline.motion.limits import LineLimits
from pipeline.motion.smoother import LineSmoother
from pipeline.motion.trajectory import LineState, LineTrajectory

__all__ = ["Gate", "LineGate", "LineLimits", "LineSmoother", "LineState", "LineTrajectory", "finish_over_box"]
