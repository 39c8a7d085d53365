"""Inverse kinematics on a 3-D grid of tool positions, with postures that vary smoothly, stored in a zarr directory."""

from ik.volume.build import VolumeReport, build_volume
from ik.volume.grid import TargetGrid, TargetStatus
from ik.volume.store import VolumeTable

__all__ = ["TargetGrid", "TargetStatus", "VolumeReport", "VolumeTable", "build_volume"]
