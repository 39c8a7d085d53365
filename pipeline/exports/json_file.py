"""Export of a model's physical parameters, with their standard deviations, as JSON."""

import json
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import inertia_about_centre
from armdyn.model_file import ModelFile
from pipeline.answers import background_force_json
from pipeline.exports.format import ExportedModelText, Format
from pipeline.exports.parts import exported_joint_dynamics
from pipeline.fields import attributes_as_json, finite_or_none
from urdf.write import INERTIA_INDICES


def parameters_json(file: ModelFile) -> dict[str, Any]:
    """JSON ``armdyn.parameters/1``: a model's effects and parameters; for an arm also its links in kg, m and kg m^2.

    The links have no standard deviations here, because they depend on correlations that the model file does not
    contain; `repair --json` has them.
    """
    model, named = file.model, file.model.without_background()
    answer: dict[str, Any] = {
        "schema": "armdyn.parameters/1",
        "base": model.base,
        "effects": [effect.label for effect in named.effects],
        "parameters": {
            name: attributes_as_json(p, "value std unit fitted meaning=" + " joint" * bool(p.joint), meaning=p.source)
            for name, p in named.parameters.items()
            if p.scope == "shared"
        },
        **background_force_json(model),
    }
    if (arm := model.capability(ArmModel)) is not None:
        answer["gravity"] = {"value": [finite_or_none(x) for x in arm.gravity()], "unit": "m/s^2", "frame": "base"}
        answer["links"] = [
            {"joint": joint.name, "urdf": link_inertia_json(joint.described), "model": link_inertia_json(joint.link)}
            for joint in exported_joint_dynamics(arm)
        ]
    return answer


def link_inertia_json(link: np.ndarray) -> dict[str, Any]:
    """JSON of a link: mass, centre of mass and inertia about it, in the frame of the joint that moves the link.

    Args:
        link: inertial parameters (10,).
    """
    mass, centre, inertia = inertia_about_centre(link)
    return {
        "mass": {"value": finite_or_none(mass), "unit": "kg"},
        "centre": {"value": dict(zip("xyz", map(finite_or_none, centre), strict=True)), "unit": "m"},
        "inertia": {
            "value": {name: finite_or_none(inertia[at]) for name, at in INERTIA_INDICES.items()},
            "unit": "kg m^2",
        },
    }


def _export(file: ModelFile, *_: object) -> ExportedModelText:
    text = json.dumps(parameters_json(file), indent=1, allow_nan=False) + "\n"
    return ExportedModelText(text, [], [effect.name for effect in file.model.effects], "its units are in it")


FORMATS = (Format(".json", "parameters", _export),)
