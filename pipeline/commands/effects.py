"""The command `armdyn effects`: list the effects that a model can have."""

from typing import Annotated, Any

import typer

from pipeline.console.options import EffectsOption, JsonOption
from pipeline.console.screen import screen_console, write_json_if_file_given

HELP_PANEL = "Models"


def effects(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[EFFECT...]", help="Effects to list; by default all.")
    ] = None,
    effects_file: EffectsOption = None,
    json_file: JsonOption = None,
) -> None:
    """List the physical effects that a model can have, with their parameters."""
    from armdyn.effects.catalogue import CATALOGUE, find
    from armdyn.effects.effect import Effect
    from armdyn.effects.user import load_effects
    from pipeline.fields import attributes_as_json

    known = (*CATALOGUE.values(), *load_effects(effects_file))
    known = tuple(find(name, known) for name in names) if names else known

    def answer(effect: Effect) -> dict[str, Any]:
        names = "unit null typical meaning=summary scope lower upper"
        quantities = {f"{effect.name}.{short}": attributes_as_json(q, names) for short, q in effect.quantities.items()}
        columns = {name: attributes_as_json(c, "name unit usual") for name, c in effect.columns.items()}
        reads = {"columns": columns} if columns else {}
        return attributes_as_json(effect, "name acts_on summary source parameters=", parameters=quantities) | reads

    if not write_json_if_file_given(
        json_file, lambda: {"schema": "armdyn.effects/1", "effects": [answer(e) for e in known]}
    ):
        return
    from rich.text import Text

    console = screen_console()
    for stage in dict.fromkeys(effect.acts_on for effect in known):
        console.print(stage, style="bold")
        for effect in (e for e in known if e.acts_on == stage):
            console.print(Text.assemble("  ", (effect.name, "cyan"), f"  {effect.summary}"))
            for short, q in effect.quantities.items():
                bounds = f"{q.lower:g} to {q.upper:g}".replace("-inf", "any").replace("inf", "any")
                console.print(
                    f"    {effect.name}.{short}  {q.unit}: {q.summary}; typical {q.typical:g}, {bounds}", style="dim"
                )
            for c in effect.columns.values():
                console.print(f"    reads {c.name}, in {c.unit}; {c.usual:g} where it was not recorded", style="dim")
            console.print(f"    {effect.source}", style="dim italic")
