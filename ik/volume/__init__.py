"""Inverse kinematics over a 3-D grid of positions on one consistent branch, stored in zarr."""

from ik.volume.build import VolumeReport, build_volume
from ik.volume.grid import Grid, Status
from ik.volume.store import VolumeTable

__all__ = ["Grid", "Status", "VolumeReport", "VolumeTable", "build_volume"]
