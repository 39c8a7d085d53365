"""Inverse kinematics on a 3-D grid of tool positions, with postures that vary smoothly, stored in a zarr directory."""

from ik.volume.build import VolumeBuildResult, build_volume
from ik.volume.grid import TargetGrid, TargetStatus
from ik.volume.store import VolumeTable

__all__ = ["TargetGrid", "TargetStatus", "VolumeBuildResult", "VolumeTable", "build_volume"]
