"""An arm under its drives: simulation in closed loop, its errors, its derivatives, and the model of its motion."""
