"""Check that recordings are as declared: checks of single signals, and hypotheses tested with a model."""
