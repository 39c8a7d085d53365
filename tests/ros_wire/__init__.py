"""ROS in processes of its own, for the tests that need it."""
