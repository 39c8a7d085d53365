"""Fits of models with states: along the measured motion with process noise, and by output error."""
