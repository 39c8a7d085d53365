"""Fits of models that simulate a motion: along the measured motion with process noise, and by output error."""
