"""Error of an exported arm that lacks some effects of the repaired model, in the recordings of the repair."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import hypot

from armdyn.arm.model import ArmModel
from armdyn.model_file import ModelFile

MAX_EXPORT_TO_REMOVED_ERROR_RATIO = 0.05
"""Largest error of an export that is written without a request, as a share of the error that the repair removed."""
MIN_LISTED_SHARE_OF_LARGEST_ERROR = 0.01
"""Smallest error of a joint that is listed, as a share of the largest joint's error."""


@dataclass(frozen=True)
class ExportDeviation:
    """Error of an exported model.

    Attributes:
        error: root mean square of the torque that is left out [N m], or of the force [N] of prismatic joints, by
            channel.
        removed: error that the repair removed, over all channels.
        sliding: channels of prismatic joints.
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
        """Error as a share of the error that the repair removed."""
        return self.total / self.removed if self.removed > 0.0 else 0.0

    @property
    def needs_explicit_request(self) -> bool:
        """Whether the error is so large that the file is only written on request."""
        return self.share > MAX_EXPORT_TO_REMOVED_ERROR_RATIO

    @property
    def sentence(self) -> str:
        """Sentence on the error, with the joints of the largest errors first."""
        least = MIN_LISTED_SHARE_OF_LARGEST_ERROR * max(self.error.values())
        listed = sorted((e, c) for c, e in self.error.items() if e > least)[::-1]
        joints = ", ".join(f"{e:.3g} {'N' if c in self.sliding else 'N m'} on {c.partition('.')[2]}" for e, c in listed)
        share = f"{100 * self.share:.2g} % of the error that the repair removed"
        return f"over the recordings it is wrong by {joints}: {share}"


def export_deviation(file: ModelFile, held: Collection[str]) -> ExportDeviation | None:
    """Error of an exported arm that has only some of the model's effects.

    The small values without a name (the background) are not counted.

    Args:
        file: model file with the history of its repairs.
        held: names of the effects that the export has.

    Returns:
        The error; None if no effect is missing, if the file has no history of a repair, or for a pendulum.
    """
    model = file.model.capability(ArmModel)
    if model is None:
        return None
    entries = [entry for entry in file.history if "contribution" in entry]
    present = {effect.name for effect in model.named_effects if effect.acts_on != "wrench"}
    error: dict[str, float] = {}
    for entry in entries:
        added = entry["added"] if isinstance(entry["added"], list) else [entry["added"]]
        if present.intersection(added).difference(held):
            for channel, value in entry["contribution"].items():
                error[channel] = hypot(error.get(channel, 0.0), float(value))
    if not error:
        return None
    before: Mapping[str, float] = next((e["as_given_rmse"] for e in entries if "as_given_rmse" in e), {})
    after = entries[-1].get("rmse", {})
    removed = sum(max(float(before[c]) ** 2 - float(after.get(c, 0.0)) ** 2, 0.0) for c in before)
    joints = zip(model.arm.joints, model.arm.slides, strict=True)
    return ExportDeviation(error, removed**0.5, [f"tau.{joint}" for joint, slides in joints if slides])
