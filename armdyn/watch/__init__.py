"""Online comparison of a model with its arm: outside torques, changed load, changed joints."""
