"""ROS over rosbridge: the connection, what is read from topics, the gate that every command passes, the twin.

Nothing is imported here: ``pipeline.ros.bridge`` (the connection), ``pipeline.ros.topics`` (which topics a robot has),
``pipeline.ros.gate`` (what may be sent) and ``pipeline.ros.twin`` (a simulated Baxter on the other side) are imported
by name. The robot itself is ``pipeline.robot.ros``.
"""
