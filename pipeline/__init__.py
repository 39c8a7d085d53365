"""The program around the models: commands, robot, load cell, motion planning, recordings and reports."""
