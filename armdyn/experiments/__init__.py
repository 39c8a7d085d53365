"""The next experiment: which one tells rival effects apart, how well, and along which motion of the gripper."""
