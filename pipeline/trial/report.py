"""What the report of a trial is told."""

import numpy as np

from armdyn.pendulum.model import run_path
from pipeline.record import Recorder
from pipeline.report.page import KeyFigure, Level
from pipeline.report.trial_data import (
    BoxOutline,
    EstimateTrace,
    ForceTrace,
    GripperTrace,
    JointTrace,
    Margin,
    NodeTiming,
    SwingPicture,
    SwingTrace,
    TrialReportData,
)
from pipeline.trial.experiment import Experiment
from pipeline.trial.result import TrialResult
