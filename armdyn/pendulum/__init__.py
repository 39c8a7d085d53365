"""The reduced model: gripper, string, load and sensor, in continuous and in variational form."""

from urdf.lazy import lazy_getattr

__all__ = ["PendulumModel", "pendulum_model"]
__getattr__ = lazy_getattr(__name__, dict.fromkeys(__all__, "armdyn.pendulum.model"))
