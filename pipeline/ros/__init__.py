"""ROS over rosbridge: the connection, what is read from topics, the twin.

Nothing is imported here: ``pipeline.ros.bridge`` (the connection), ``pipeline.ros.topics`` (which topics a robot has),
``pipeline.ros.twin`` (a simulated Baxter on the other side) are imported by name. The robot itself is
``pipeline.robot.drivers.ros``, what may be sent to it ``pipeline.motion.gate``.
"""
