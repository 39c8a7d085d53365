"""Recordings that others made, as runs: tables, ROS bags, LeRobot data sets."""
