"""Motions: one that informs (sequential action control), one that does the task (projection-based optimisation)."""
