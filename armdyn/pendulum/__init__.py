"""The reduced model: gripper, string, load and sensor, in continuous and in variational form."""

from typing import Any

__all__ = ["PendulumModel", "pendulum_model"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'armdyn.pendulum' has no attribute '{name}'")
    from armdyn.pendulum import model

    return getattr(model, name)
