"""Force/torque sensors: the wrench of what hangs behind a frame of the arm."""
