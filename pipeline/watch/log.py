"""Log of the samples as recordings; a new file starts at each change, so that a repair can use what follows."""

from pathlib import Path
from typing import TextIO

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.watch.fault_free import JointSample


class Log:
    """Writes samples as they arrive; each line is flushed at once, and later files never overwrite a file.

    Args:
        file: first recording; ``run_2.csv`` follows ``run.csv``.
        model: the arm.

    Attributes:
        file: the recording that is being written.

    Raises:
        InputError: the file cannot be written.
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

    def write(self, sample: JointSample) -> None:
        """Write a sample; missing values are empty cells."""
        stamp, q, tau = sample
        cells = ("" if np.isnan(value) else repr(float(value)) for value in (stamp, *q, *tau[self._asked]))
        self._stream.write(",".join(cells) + "\n")

    def next_file(self) -> None:
        """Start a new file, with the next number that is free."""
        self.close()
        while self.file.exists():
            self._count += 1
            self.file = self._first.with_stem(f"{self._first.stem}_{self._count}")
        self._stream = self._opened()

    def close(self) -> None:
        """Close the present file."""
        self._stream.close()
