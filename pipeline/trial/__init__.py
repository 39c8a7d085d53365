"""A trial, the paper's experiment: learn the string's length, plan a swing, put the load into a box."""

from pipeline.trial.result import TrialResult
from pipeline.trial.settings import ProtocolSettings, TrialSettings
from pipeline.trial.simulated import SimulatedTrial, run_trial, simulate_trial

__all__ = ["ProtocolSettings", "SimulatedTrial", "TrialResult", "TrialSettings", "run_trial", "simulate_trial"]
