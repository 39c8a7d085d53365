"""The full arm: joint torques of any URDF by Pinocchio, with effects that can be added by name."""

from urdf.lazy import lazy_getattr

__all__ = ["ArmModel", "arm_model"]
__getattr__ = lazy_getattr(__name__, dict.fromkeys(__all__, "armdyn.arm.model"))
