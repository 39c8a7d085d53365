"""ROS over rosbridge: the connection, the topics that are read, and the twin (a simulated Baxter on ROS).

Nothing is imported here: ``pipeline.ros.bridge`` (the connection), ``pipeline.ros.topics`` (which topics a robot has),
``pipeline.ros.twin`` (a simulated Baxter on the other side) are imported by name. The robot itself is
``pipeline.robot.drivers.ros``, what may be sent to it ``pipeline.motion.gate``.
"""
