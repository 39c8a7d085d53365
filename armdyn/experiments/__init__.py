"""The next experiment: which one tells most, how well, and along which motion of a gripper or of an arm."""
