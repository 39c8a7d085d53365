"""`armdyn effects`: the catalogue, and a user's own effects."""

from pathlib import Path
from typing import Any

import typer

from pipeline.commands.identify_options import EffectsOption
from pipeline.commands.output import JsonOption, to_screen, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(effects)


def effects(effects_file: EffectsOption = None, json_file: JsonOption = None) -> None:
    """Show the physical effects that a model can have, with their parameters."""
    from armdyn.effects.catalogue import CATALOGUE, STAGES
    from armdyn.effects.effect import Effect
    from armdyn.effects.user import load_effects

    known = (*CATALOGUE.values(), *(load_effects(effects_file) if effects_file is not None else ()))

    def answer(effect: Effect) -> dict[str, Any]:
        parameters = {
            f"{effect.name}.{short}": {
                "unit": q.unit, "null": q.null, "typical": q.typical, "meaning": q.summary, "scope": q.scope,
                "lower": q.lower if q.lower > float("-inf") else None,
                "upper": q.upper if q.upper < float("inf") else None,
            }
            for short, q in effect.quantities.items()
        }  # fmt: skip
        return {
            "name": effect.name, "acts_on": effect.acts_on, "summary": effect.summary, "source": effect.source,
            "parameters": parameters,
        }  # fmt: skip

    if json_file is not None:
        write_json({"schema": "armdyn.effects/1", "effects": [answer(effect) for effect in known]}, json_file)
    if json_file == Path("-"):
        return
    console = to_screen()
    for stage in STAGES:
        console.print(f"[bold]{stage}[/]")
        for effect in (e for e in known if e.acts_on == stage):
            console.print(f"  [cyan]{effect.name}[/]  {effect.summary}")
            for short, q in effect.quantities.items():
                bounds = f"{q.lower:g} to {q.upper:g}".replace("-inf", "any").replace("inf", "any")
                console.print(
                    f"    {effect.name}.{short}  {q.unit}: {q.summary}; typical {q.typical:g}, {bounds}", style="dim"
                )
            console.print(f"    {effect.source}", style="dim italic")
