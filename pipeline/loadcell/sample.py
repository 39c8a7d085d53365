"""One reading of a load cell: the same class for the simulated robot and for the real cell."""

from pipeline.robot.protocol import ForceSample

__all__ = ["ForceSample"]
