"""What runs: commands, nodes, robot, load cell, motion, recordings and reports."""
