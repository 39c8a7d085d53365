"""The full arm: joint torques of any URDF by Pinocchio, with effects that can be added by name."""

from typing import Any

__all__ = ["ArmModel", "arm_model"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'armdyn.arm' has no attribute '{name}'")
    from armdyn.arm import model

    return getattr(model, name)
