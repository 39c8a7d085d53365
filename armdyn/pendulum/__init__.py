"""The model of a load that hangs on a string from a gripper: continuous and discrete (variational) equations."""

from urdf.lazy import lazy_getattr

__all__ = ["PendulumModel", "pendulum_model"]
__getattr__ = lazy_getattr(__name__, dict.fromkeys(__all__, "armdyn.pendulum.model"))
