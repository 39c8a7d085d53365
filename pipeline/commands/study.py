"""What `compare`, `diagnose`, `add` and `repair` have in common: a model file, runs, a user's own effects."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from armdyn.identify.compare import Comparison, FittedParameter
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.repair import Repair
    from armdyn.identify.study import Study
    from armdyn.model import Model
    from armdyn.model_file import ModelFile

ModelArgument = Annotated[Path, typer.Argument(help="Model file, such as 'armdyn new' writes.", metavar="M.toml")]
RunsArgument = Annotated[list[Path], typer.Argument(help="Recordings, .csv or .mcap.", metavar="RUN...")]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option("--held-out", help="A recording that takes no part in the fit; give it again for more."),
]
EffectsOption = Annotated[
    list[Path] | None, typer.Option("--effects", help="Python file with effects of your own; give it again for more.")
]
ReportOption = Annotated[Path | None, typer.Option("--report", help="Write an HTML report there.")]


def own_effects(files: list[Path] | None) -> tuple[Any, ...]:
    """Effects of a user's own files."""
    from armdyn.effects.user import load_effects

    return tuple(effect for file in files or [] for effect in load_effects(file))


def open_study(
    model: Path, runs: list[Path], held_out: list[Path] | None, effects: list[Path] | None
) -> tuple["ModelFile", "Study"]:
    """Read everything that a comparison needs.

    Raises:
        InputError: a file cannot be used; the message names it.
    """
    from armdyn.effects.catalogue import CATALOGUE
    from armdyn.identify.study import Study
    from armdyn.model_file import read_model_file
    from armdyn.run import read_run

    own = own_effects(effects)
    file = read_model_file(model, own)
    training, others = ([read_run(path) for path in paths] for paths in (runs, held_out or []))
    return file, Study(file.model, training, others, (*CATALOGUE.values(), *own))


def model_json(model: "Model") -> dict[str, Any]:
    """What a model is, in the contract's form."""
    return {"base": model.base, "effects": [effect.label for effect in model.effects]}


def parameters_json(parameters: "dict[str, FittedParameter]") -> dict[str, Any]:
    """Values with their standard deviations and units."""
    return {n: {"value": p.value, "std": finite(p.std), "unit": p.unit} for n, p in parameters.items()}


def comparison_json(comparison: "Comparison") -> dict[str, Any]:
    """Parameters, channels and places of failure, as in ``armdyn.diagnosis/1``."""
    return {
        "parameters": parameters_json(comparison.parameters),
        "intervals_hold": comparison.intervals_hold,
        "at_bound": list(comparison.at_bound),
        "undetermined": list(comparison.undetermined),
        "absorbed": comparison.absorbed,
        "channels": {
            name: {
                "unit": c.unit,
                "noise_std": c.noise_std,
                "rmse": c.rmse,
                "held_out_rmse": finite(c.held_out_rmse),
                "chi2_per_sample": c.chi2_per_sample,
            }
            for name, c in comparison.channels.items()
        },
        "where": [
            {
                "channel": p.channel,
                "run": p.run,
                "against": p.against,
                "from": p.start,
                "to": p.end,
                "unit": p.unit,
                "chi2_per_sample": p.chi2_per_sample,
            }
            for p in comparison.places
        ],
    }


def diagnosis_json(model: "Model", found: "Diagnosis") -> dict[str, Any]:
    """The contract's ``armdyn.diagnosis/1``."""
    return {
        "schema": "armdyn.diagnosis/1",
        "model": model_json(model),
        "verdict": found.verdict.key,
        "sentence": found.sentence,
        **comparison_json(found.comparison),
        "candidates": [
            {
                "effect": s.effect,
                "joints": list(s.joints),
                "delta_bic": s.delta_bic,
                "p_value": s.p_value,
                "rmse": s.rmse,
                "held_out_rmse": s.held_out_rmse,
                "parameters": parameters_json(s.parameters),
                "tied_with": list(s.tied_with),
            }
            for s in found.suspects
        ],
        "remedies": list(found.remedies),
    }


def repair_json(found: "Repair") -> dict[str, Any]:
    """The contract's ``armdyn.repair/1``; a step that added several effects at once names the others in ``with``."""
    return {
        "schema": "armdyn.repair/1",
        "verdict": found.verdict.key,
        "sentence": found.sentence,
        "effects": [effect.label for effect in found.model.effects],
        "parameters": parameters_json(found.after.parameters),
        "steps": [
            {
                "added": rung.added[0] if rung.added else None,
                "with": list(rung.added[1:]),
                "removed": list(rung.removed),
                "joints": list(rung.joints),
                "tied_with": list(rung.tied_with),
                "rmse": rung.rmse,
                "held_out_rmse": rung.held_out_rmse,
                "chi2_per_sample": rung.chi2_per_sample,
                "bic": rung.bic,
            }
            for rung in found.ladder
        ],
    }


def finite(value: float | None) -> float | None:
    """The value, or None where JSON has no number for it."""
    import math

    return value if value is not None and math.isfinite(value) else None


def save_repaired(file: "ModelFile", found: "Repair", runs: list[Path], held_out: list[Path] | None, out: Path) -> None:
    """Write the repaired model with one history entry per step."""
    from dataclasses import replace

    from armdyn.model_file import write_model_file

    entries = [
        {
            "added": " + ".join(rung.added),
            **({"removed": list(rung.removed)} if rung.removed else {}),
            **({"joints": list(rung.joints)} if rung.joints else {}),
            "runs": [path.name for path in runs],
            "held_out": [path.name for path in held_out or []],
            "rmse": rung.rmse,
            "held_out_rmse": rung.held_out_rmse,
            "chi2_per_sample": rung.chi2_per_sample,
            "bic": rung.bic,
        }
        for rung in found.ladder[1:]
    ]
    write_model_file(out, replace(file, model=found.model, history=(*file.history, *entries)))
