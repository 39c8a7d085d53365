"""The nodes of a trial: measurement, estimator, Sequential Action Control (SAC), task, drive; and their scheduler."""
