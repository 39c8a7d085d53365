"""The paper's whole experiment: learn the length, plan the swing, put the load into the box."""

from pipeline.trial.result import TrialResult
from pipeline.trial.settings import ProtocolSettings, TrialSettings
from pipeline.trial.simulated import SimulatedTrial, run_trial, simulate

__all__ = ["ProtocolSettings", "SimulatedTrial", "TrialResult", "TrialSettings", "run_trial", "simulate"]
