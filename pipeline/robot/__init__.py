"""Robots: the interface of a robot, and the simulated Baxter that implements it.

Nothing is imported here, so that ``armdyn --help`` does not pay for MuJoCo:
``pipeline.robot.protocol`` (interface), ``pipeline.robot.settings``, ``pipeline.robot.truth`` and
``pipeline.robot.simulated`` are imported by name.
"""
