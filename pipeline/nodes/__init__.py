"""The paper's four nodes (measurement, estimator, SAC, task), the drive that moves the arm, and their scheduler."""
