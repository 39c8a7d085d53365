"""Log of a watch's samples as recordings, with a new file after each change of the arm, for a repair of the model."""

from pathlib import Path

import numpy as np

from armdyn.atomic import CrashSafeGrowingFile
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.fault_free import JointSample


class SampleLog:
    """Writes an arm's samples to recordings in CSV; every line is written at once, and existing later files are kept.

    A full disk ends the log, not the watch: see `CrashSafeGrowingFile`.

    Args:
        file: first recording; ``run_2.csv`` follows ``run.csv``.
        channels: the channels, which name the columns.

    Attributes:
        file: recording to which samples are written at present.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, file: Path, channels: WatchedChannels) -> None:
        self._first, self._count = file, 1
        self._asked = channels.asked
        slides = [unit == "N" for unit in channels.units]
        heads = ["time [s]"]
        heads += [
            f"q.{joint} [{'m' if slide else 'rad'}]" for joint, slide in zip(channels.joints, slides, strict=False)
        ]
        heads += [
            f"{name} [{unit}]"
            for name, unit, is_asked in zip(channels.names, channels.units, channels.asked, strict=True)
            if is_asked
        ]
        self._heads = ",".join(heads)
        self.file = file
        self._stream = self._opened()

    def _opened(self) -> CrashSafeGrowingFile:
        stream = CrashSafeGrowingFile(self.file)
        stream.write(self._heads + "\n")
        return stream

    @property
    def failure(self) -> str | None:
        """Why the log could not be written any further; None while it can."""
        return self._stream.failure

    def write(self, sample: JointSample) -> None:
        """Write a sample as one line; a missing value (nan) becomes an empty cell."""
        stamp, q, tau = sample
        cells = ("" if np.isnan(value) else repr(float(value)) for value in (stamp, *q, *tau[self._asked]))
        self._stream.write(",".join(cells) + "\n")

    def next_file(self) -> None:
        """Close the present file, and start the file with the next unused number; nothing after a full disk."""
        self.close()
        if self.failure is not None:
            return
        while self.file.exists():
            self._count += 1
            self.file = self._first.with_stem(f"{self._first.stem}_{self._count}")
        self._stream = self._opened()

    def close(self) -> None:
        """Close the present file."""
        self._stream.finish()
