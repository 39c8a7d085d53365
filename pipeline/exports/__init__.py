"""Models for other tools: URDF, MuJoCo, C and Python functions, JSON."""
