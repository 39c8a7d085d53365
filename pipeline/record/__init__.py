"""Recordings: samples to MCAP while the robot runs, CSV and sidecar at the end."""

from pipeline.record.recorder import Recorder

__all__ = ["Recorder"]
