"""What came, kept as recordings: another one begins where the load or the robot changed, for a repair from then on."""

from pathlib import Path
from typing import TextIO

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.watch.sound import Sample


class Log:
    """Writes samples as they come; every line is in the file at once, and no later part writes over a file.

    Args:
        file: of the first recording; ``run.csv`` is followed by ``run_2.csv``.
        model: the arm.

    Attributes:
        file: that is written now.

    Raises:
        InputError: it cannot be written.
    """

    def __init__(self, file: Path, model: ArmModel) -> None:
        self._first, self._count = file, 1
        joints, slides = model.arm.joints, model.arm.slides
        units = [("m", "N") if slide else ("rad", "N m") for slide in slides]
        self._asked = np.array([joint in model.joints for joint in joints])
        heads = ["time [s]", *(f"q.{joint} [{unit}]" for joint, (unit, _) in zip(joints, units, strict=True))]
        heads += [
            f"tau.{joint} [{unit}]" for joint, (_, unit) in zip(joints, units, strict=True) if joint in model.joints
        ]
        self._heads = ",".join(heads)
        self.file = file
        self._stream = self._opened()

    def _opened(self) -> TextIO:
        try:
            stream = self.file.open("w", encoding="utf-8", buffering=1)
        except OSError as error:
            raise InputError(f"cannot write {self.file}: {error.strerror}; choose another place, --log") from error
        stream.write(self._heads + "\n")
        return stream

    def keep(self, sample: Sample) -> None:
        """Write a sample; what is missing of it is left empty."""
        stamp, q, tau = sample
        cells = ("" if np.isnan(value) else repr(float(value)) for value in (stamp, *q, *tau[self._asked]))
        self._stream.write(",".join(cells) + "\n")

    def part(self) -> None:
        """Begin another recording, of the next number that no file has."""
        self.close()
        while self.file.exists():
            self._count += 1
            self.file = self._first.with_stem(f"{self._first.stem}_{self._count}")
        self._stream = self._opened()

    def close(self) -> None:
        """Write what is not written yet."""
        self._stream.close()
