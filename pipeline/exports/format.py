"""A format in which a model can be exported."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model_file import ModelFile


class ExportedModelText(NamedTuple):
    """A model in one format.

    Attributes:
        text: content of the file.
        notes: sentences on parts of the model that the format cannot express.
        held: names of the effects that the format can express.
        usage: command or line of code that uses the file.
    """

    text: str
    notes: list[str]
    held: Collection[str]
    usage: str


class Format(NamedTuple):
    """A file format for the export of models.

    Attributes:
        ending: ending of the file names, such as ``".urdf"``.
        kind: name of the format.
        export: function from the model, the path of the file to write, and a comment line to the exported text.
    """

    ending: str
    kind: str
    export: Callable[[ModelFile, Path, str], ExportedModelText]


def arm_of_model_file(file: ModelFile, output: Path) -> ArmModel:
    """The arm of a model file.

    Raises:
        InputError: the model is not an arm.
    """
    arm = file.model.capability(ArmModel)
    if arm is None:
        raise InputError(
            f"{output.suffix} is for arms, and this model's base is '{file.model.base}': write it as .c, .py or .json"
        )
    return arm
