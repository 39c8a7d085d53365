"""Plan the next experiment: which one distinguishes hypotheses best, and along which motion."""
