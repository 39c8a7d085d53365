"""The catalogue of effects by name, and look-ups in it."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from armdyn.effects import drive, gripper, joint, load, sensor, string, wrench
from armdyn.effects.effect import Effect
from armdyn.errors import UnknownNameError


def _collect() -> Mapping[str, Effect]:
    modules = (gripper, string, load, sensor, joint, drive, wrench)
    found = (item for module in modules for item in vars(module).values() if isinstance(item, Effect))
    return MappingProxyType({item.name: item for item in found})


CATALOGUE: Mapping[str, Effect] = _collect()
STAGES: tuple[str, ...] = tuple(dict.fromkeys((*(item.acts_on for item in CATALOGUE.values()), "tension")))
"""Names of the stages (parts of the equations) on which effects act; on ``"tension"``, only a user's own effects do.

A user's own base model may have other stages.
"""


def find(name: str, extra: Iterable[Effect] = ()) -> Effect:
    """Find an effect by its name, in the catalogue or among a user's own effects.

    Args:
        name: ``"<effect>"``, or ``"<effect>:<joint>,<joint>"`` for one that acts on these joints only.
        extra: a user's own effects.

    Raises:
        UnknownNameError: no effect has this name; the message names the most similar one.
    """
    name, _, joints = name.partition(":")
    known = {**CATALOGUE, **{item.name: item for item in extra}}
    if name not in known:
        raise UnknownNameError("effect", name, known)
    found = known[name]
    return found.on(*(joint.strip() for joint in joints.split(","))) if joints else found


def find_several(names: str, extra: Iterable[Effect] = ()) -> tuple[Effect, ...]:
    """Find the effects that a text such as ``"rotor_inertia+joint_spring:elbow,wrist"`` names; see `find`."""
    known = tuple(extra)
    return tuple(find(name.strip(), known) for name in names.split("+"))


def catalogue_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Sort effects: those of the catalogue in its order, then a user's own by name."""
    place = {name: i for i, name in enumerate(CATALOGUE)}
    return tuple(sorted(effects, key=lambda e: (place.get(e.name, len(place)), e.name)))
