"""The paper's whole experiment: learn the length, plan the swing, put the load into the box."""

from pipeline.trial.experiment import run_trial
from pipeline.trial.result import TrialResult
from pipeline.trial.settings import TrialSettings

__all__ = ["TrialResult", "TrialSettings", "run_trial"]
