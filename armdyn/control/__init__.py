"""Plan motions: informative ones (sequential action control), and the task's (projection-based optimisation)."""
