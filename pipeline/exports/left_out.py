"""What an exported arm lacks of the repaired one, in N m over the recordings that it was repaired with."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import hypot

from armdyn.arm.model import ArmModel
from armdyn.model_file import ModelFile

MOST = 0.05
"""Of the error that the repair removed: what may be left out without being asked for."""
WORTH_SAYING = 0.01
"""Of the largest joint's error, below which a joint is not listed."""


@dataclass(frozen=True)
class LeftOut:
    """How wrong an exported model is.

    Attributes:
        error: by channel, rms of what is left out, N m; N of joints that slide.
        removed: error that the repair removed, over all channels.
        sliding: channels of joints that slide.
    """

    error: Mapping[str, float]
    removed: float
    sliding: Collection[str]

    @property
    def total(self) -> float:
        """Error over all channels."""
        return hypot(*self.error.values())

    @property
    def share(self) -> float:
        """Of the error that the repair removed."""
        return self.total / self.removed if self.removed > 0.0 else 0.0

    @property
    def matters(self) -> bool:
        """Whether nobody should use the file without knowing."""
        return self.share > MOST

    @property
    def sentence(self) -> str:
        """For a person, the joints that lose most first."""
        largest = max(self.error.values())
        listed = sorted((e, c) for c, e in self.error.items() if e > WORTH_SAYING * largest)[::-1]
        units = {channel: "N" if channel in self.sliding else "N m" for channel in self.error}
        joints = ", ".join(f"{error:.3g} {units[channel]} on {channel.partition('.')[2]}" for error, channel in listed)
        share = f"{100 * self.share:.2g} % of the error that the repair removed"
        return f"over the recordings it is wrong by {joints}: {share}"


def left_out(file: ModelFile, held: Collection[str]) -> LeftOut | None:
    """What a file that holds the effects `held` lacks; None where that is nothing, or no repair of an arm is on record.

    Values of the background are small and not counted; a pendulum's functions are of its motion: what its sensors do is
    no part of that.
    """
    if not isinstance(file.model, ArmModel):
        return None
    entries = [entry for entry in file.history if "contribution" in entry]
    present = {effect.name for effect in file.model.named_effects}
    error: dict[str, float] = {}
    for entry in entries:
        added = entry["added"] if isinstance(entry["added"], list) else [entry["added"]]
        if not present.intersection(added).difference(held):
            continue
        for channel, value in entry["contribution"].items():
            error[channel] = hypot(error.get(channel, 0.0), float(value))
    if not error:
        return None
    before: Mapping[str, float] = next((e["as_given_rmse"] for e in entries if "as_given_rmse" in e), {})
    after = entries[-1].get("rmse", {})
    gone = sum(max(float(before[c]) ** 2 - float(after.get(c, 0.0)) ** 2, 0.0) for c in before)
    joints = zip(file.model.arm.joints, file.model.arm.slides, strict=True)
    return LeftOut(error, gone**0.5, [f"tau.{joint}" for joint, slides in joints if slides])
