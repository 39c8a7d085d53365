"""The catalogue of physical effects that can be added to a model; each module has the effects of one stage."""

from urdf.lazy import lazy_getattr

_CATALOGUE = "armdyn.effects.catalogue"
__all__ = ["CATALOGUE", "find", "load_effects"]
__getattr__ = lazy_getattr(
    __name__, {"CATALOGUE": _CATALOGUE, "find": _CATALOGUE, "load_effects": "armdyn.effects.user"}
)
