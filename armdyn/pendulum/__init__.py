"""The reduced model: gripper, string, load and sensor, in continuous and in variational form."""
