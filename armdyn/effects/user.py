"""A user's own effects, from a Python file that defines them with `@effect`."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.effects.catalogue import CATALOGUE, STAGES
from armdyn.effects.effect import Effect
from armdyn.effects.effect_checks import check_applied, check_declared
from armdyn.errors import InputError
from armdyn.user_code import load_module

if TYPE_CHECKING:
    from armdyn.model import Model


def load_effects(path: str | Path | None, stages: Collection[str] | None = STAGES) -> tuple[Effect, ...]:
    """Load the effects that a file defines, in their order in the file.

    The file is run as Python: it may do whatever a Python program may.

    Args:
        path: path of the file; None for no file.
        stages: stages on which effects may act; None for any.

    Raises:
        InputError: the file cannot be read or run, it defines no effect, or one of its effects has the name of an
            effect of the catalogue or acts on an unknown stage.
    """
    if path is None:
        return ()
    file = Path(path)
    own = effects_defined_in(file, vars(load_module(file, "effects")))
    if not own:
        raise InputError(f"{file}: defines no effect: write a function with @effect(...), see examples/my_effects.py")
    if stages is not None:
        _check_stages(own, stages, file)
    for item in own:
        # Where another base may define a stage differently, an effect only has to end.
        with nullcontext() if stages is not None else suppress(InputError):
            check_applied(item, file)
    return own


def available_effects(model: "Model", own: Sequence[Effect] = (), path: str | Path | None = None) -> tuple[Effect, ...]:
    """Effects that a model can have: those of the catalogue, of its base model and of the user's file.

    Args:
        model: the model; effects that act on none of its stages are left out.
        own: effects of the user's file, loaded without a check of their stages.
        path: path of that file, for the message.

    Raises:
        InputError: an effect of the file acts on a stage that no model has.
    """
    _check_stages(own, (*STAGES, *model.stages), path)
    if path is not None and model.has_catalogue_stages:
        for item in own:
            if item.acts_on in model.stages:
                check_applied(item, Path(path))
    return tuple(e for e in (*CATALOGUE.values(), *model.own_effects, *own) if e.acts_on in model.stages)


def _check_stages(effects: Iterable[Effect], stages: Iterable[str], path: str | Path | None) -> None:
    known = dict.fromkeys(stages)
    for item in effects:
        if item.acts_on not in known:
            listed = ", ".join(known)
            raise InputError(f"{path}: effect '{item.name}' acts on '{item.acts_on}': choose one of {listed}")


def effects_defined_in(path: Path, defined: Mapping[str, object]) -> tuple[Effect, ...]:
    """The effects that a Python file defines, without those that it imports from the catalogue.

    Args:
        path: path of the file.
        defined: the file's global variables, by name.

    Raises:
        InputError: an effect has the name of another one, or its declaration cannot be used.
    """
    catalogue = list(CATALOGUE.values())
    own = tuple(dict.fromkeys(e for e in defined.values() if isinstance(e, Effect) and e not in catalogue))
    for item in own:
        if item.name in CATALOGUE:
            raise InputError(f"{path}: '{item.name}' has the name of an effect of the catalogue: give it another")
    check_declared(own, path)
    return own
