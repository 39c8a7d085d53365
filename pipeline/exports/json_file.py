"""A model's physical parameters with their standard deviations, as JSON."""

import json
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import about_centre
from armdyn.model_file import ModelFile
from pipeline.answers import background_answer
from pipeline.exports.format import Format
from pipeline.exports.parts import parts_of
from pipeline.fields import number
from urdf.write import MOMENTS

AXES = ("x", "y", "z")


def parameters_answer(file: ModelFile) -> dict[str, Any]:
    """The file's content; an arm's links beside it in kg, m and kg m^2.

    A link's values follow from several parameters whose correlation the model file does not keep: `repair --json` tells
    their standard deviations.
    """
    model, named = file.model, file.model.named_only()
    answer: dict[str, Any] = {
        "schema": "armdyn.parameters/1",
        "base": model.base,
        "effects": [effect.label for effect in named.effects],
        "parameters": {
            name: {
                "value": number(p.value),
                "std": number(p.std),
                "unit": p.unit,
                "fitted": p.fitted,
                "meaning": p.source,
                **({"joint": p.joint} if p.joint else {}),
            }
            for name, p in named.parameters.items()
            if p.scope == "shared"
        },
        **background_answer(model),
    }
    if isinstance(model, ArmModel):
        parts = parts_of(model)
        answer["gravity"] = {"value": [number(x) for x in parts.gravity], "unit": "m/s^2", "frame": "base"}
        answer["links"] = [
            {"joint": joint.name, "urdf": link_answer(joint.described), "model": link_answer(joint.link)}
            for joint in parts.joints
        ]
    return answer


def link_answer(link: np.ndarray) -> dict[str, Any]:
    """Mass, centre and inertia about it of (10,) inertial parameters, in the frame of the joint that moves the link."""
    mass, centre, inertia = about_centre(link)
    return {
        "mass": {"value": number(mass), "unit": "kg"},
        "centre": {"value": dict(zip(AXES, map(number, centre), strict=True)), "unit": "m"},
        "inertia": {"value": {name: number(inertia[at]) for name, at in MOMENTS.items()}, "unit": "kg m^2"},
    }


FORMATS = (
    Format(
        ".json",
        "parameters",
        lambda file, *_: (json.dumps(parameters_answer(file), indent=1, allow_nan=False) + "\n", []),
        lambda model: frozenset(effect.name for effect in model.effects),
        lambda *_: "its units are in it",
    ),
)
