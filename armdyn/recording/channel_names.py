"""Names of channels for a reader, such as ``"torque of elbow"`` for ``tau.elbow``."""

from armdyn.recording.channels import EXTRA_PREFIX

_OF_A_JOINT = {
    "tau": "torque", "q": "position", "v": "velocity", "a": "acceleration", "q_cmd": "commanded position",
    "v_cmd": "commanded velocity", "tau_ff": "commanded torque", "duty": "duty", "current": "current",
    "voltage": "voltage", "enabled": "enabled",
}  # fmt: skip
_PENDULUM = {
    "load_force": "string tension",
    "swing_angle": "swing angle",
    "swing_rate": "swing rate",
    "gripper_x": "gripper position",
    "gripper_v": "gripper velocity",
    "gripper_a": "gripper acceleration",
    "gripper_z": "gripper height",
}


def channel_quantity(channel: str, unit: str = "N m") -> str:
    """Physical quantity of a channel, such as ``"torque"`` for ``tau.elbow``; with the unit N it is a force."""
    kind, dot, _ = channel.partition(".")
    if dot and kind in _OF_A_JOINT:
        return "force" if kind == "tau" and unit == "N" else _OF_A_JOINT[kind]
    return _PENDULUM.get(channel, channel.removeprefix(f"{EXTRA_PREFIX}.").replace("_", " "))


def channel_short_name(channel: str) -> str:
    """Short name of a channel: its joint, such as ``"elbow"`` for ``tau.elbow``, or else its quantity."""
    kind, _, joint = channel.partition(".")
    return joint if joint and kind in _OF_A_JOINT else channel_quantity(channel)


def channel_full_name(channel: str, unit: str = "N m") -> str:
    """Full name of a channel, such as ``"torque of elbow"`` for ``tau.elbow``."""
    kind, _, joint = channel.partition(".")
    name = channel_quantity(channel, unit)
    return f"{name} of {joint}" if joint and kind in _OF_A_JOINT else name
