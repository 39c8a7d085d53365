"""ROS over rosbridge: the connection, the topics that are read, and the twin, a simulated Baxter on ROS."""
