"""Fits of an arm whose servos record positions and commands, by its simulated motion."""
