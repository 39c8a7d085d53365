"""armdyn: learn what a robot arm handles, use it, and find out where the model is wrong."""

__version__ = "0.1.0"
