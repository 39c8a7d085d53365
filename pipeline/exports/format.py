"""A format that a model can be exported to, and the model that it is for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.model_file import ModelFile


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes:
        ending: of the files' names, such as ``".urdf"``.
        kind: what such a file is.
        text: of a model's file, the file to write and a line about the model: what is written, and a sentence for each
            thing that the format cannot hold.
        held: names of the effects of a model that the format holds.
        usage: what to do with a file that was written, for a model and the file.
    """

    ending: str
    kind: str
    text: Callable[[ModelFile, Path, str], tuple[str, list[str]]]
    held: Callable[[Model], frozenset[str]]
    usage: Callable[[Model, Path], str]


def arm_of(file: ModelFile, output: Path) -> ArmModel:
    """The arm of a model file.

    Raises:
        InputError: it is no arm.
    """
    if not isinstance(file.model, ArmModel):
        raise InputError(
            f"{output.suffix} is for arms, and this model's base is '{file.model.base}': write it as .c, .py or .json"
        )
    return file.model
