"""What a reader calls a channel: ``tau.elbow`` is the torque of the elbow."""

_OF_A_JOINT = {"tau": "torque", "q": "position", "v": "velocity", "a": "acceleration"}
_PENDULUM = {
    "load_force": "string tension",
    "swing_angle": "swing angle",
    "swing_rate": "swing rate",
    "gripper_x": "gripper position",
    "gripper_v": "gripper velocity",
    "gripper_a": "gripper acceleration",
    "gripper_z": "gripper height",
}


def quantity_of(channel: str, unit: str = "N m") -> str:
    """The physical quantity, such as ``"torque"``; a joint that slides has a force."""
    kind, dot, _ = channel.partition(".")
    if dot and kind in _OF_A_JOINT:
        return "force" if kind == "tau" and unit == "N" else _OF_A_JOINT[kind]
    return _PENDULUM.get(channel, channel.replace("_", " "))


def short_name(channel: str) -> str:
    """What tells it from the other channels that are measured: the joint, or the quantity."""
    kind, _, joint = channel.partition(".")
    return joint if joint and kind in _OF_A_JOINT else quantity_of(channel)


def full_name(channel: str, unit: str = "N m") -> str:
    """Such as ``"torque of elbow"``."""
    kind, _, joint = channel.partition(".")
    name = quantity_of(channel, unit)
    return f"{name} of {joint}" if joint and kind in _OF_A_JOINT else name
