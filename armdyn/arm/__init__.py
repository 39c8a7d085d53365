"""The full arm: joint torques of any URDF by Pinocchio, with effects that can be added by name."""
