"""Robots: the interface of a robot, and the simulated Baxter that implements it."""
