"""What a check of a recording says: what, where, how sure, and the remedy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from armdyn.errors import TaskFailedError
from armdyn.inspection.correction import Correction
from armdyn.run import Run

Kind: TypeAlias = Literal[
    "angle_unit", "torque_unit", "torque_sign", "position_sign", "joints_swapped", "position_offset", "clock_shift",
    "gravity_direction", "scale", "gap", "glitch", "counts_lost", "saturated", "frozen", "repeated_samples", "rate",
    "noise_misstated", "no_motion", "implausible_model", "samples_dropped", "second_publisher", "joint_left_out",
    "unusable", "wrapped", "filtered", "sign_missing", "without_gravity", "unanswered_check", "sticking",
]  # fmt: skip


class Severity(Enum):
    """How much a check matters; the value is for a person."""

    WRONG = "the recording is not what it says: mend it first"
    SUSPECT = "look at it before you believe what follows"
    NOTE = "handled, and worth knowing"

    @property
    def key(self) -> str:
        """In JSON."""
        return self.name.lower()


@dataclass(frozen=True)
class Check:
    """One thing that is odd about a recording, or about a model that was fitted to it.

    Attributes:
        kind: in one word.
        severity: how much it matters.
        run: name of the run; None where it concerns the model.
        channels: concerned.
        sentence: what, where and how sure.
        remedy: what to do, as a line to type where there is one.
        start: s, where it begins; None where it concerns the whole run.
        end: s, where it ends.
        evidence: nats, logarithm of how much more probable the recording is so than by the next best hypothesis; of a
            check without hypotheses None.
        correction: of the recording; None where only recording again helps.
    """

    kind: Kind
    severity: Severity
    run: str | None
    channels: tuple[str, ...]
    sentence: str
    remedy: str
    start: float | None = None
    end: float | None = None
    evidence: float | None = None
    correction: Correction | None = None


@dataclass(frozen=True)
class Inspection:
    """All checks of some recordings, the worst first.

    Attributes:
        runs: as recorded.
        checks: of them.
    """

    runs: tuple[Run, ...]
    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        return f"Inspection: {self.sentence}"

    @property
    def wrong(self) -> tuple[Check, ...]:
        """Checks that make the recordings unusable."""
        return tuple(check for check in self.checks if check.severity is Severity.WRONG)

    @property
    def usable(self) -> bool:
        """Whether the recordings can be held against a model as they are."""
        return not self.wrong

    @property
    def sentence(self) -> str:
        """For a person."""
        first = (self.wrong or self.of(Severity.SUSPECT))[:1]
        if not first:
            many = len(self.runs)
            return (
                f"The recording{'s are' if many > 1 else ' is'} what {'they say they are' if many > 1 else 'it says'}."
            )
        more = len(self.wrong or self.of(Severity.SUSPECT)) - 1
        (check,) = first
        where = f"{check.run}: " if check.run else ""
        return f"{where}{check.sentence}" + (f" ({more} more of this kind.)" if more else "")

    def naming(self, model: Path) -> "Inspection":
        """The same with the model's file in what can be typed."""
        return replace(self, checks=tuple(replace(c, remedy=c.remedy.replace(MODEL, str(model))) for c in self.checks))

    def of(self, severity: Severity) -> tuple[Check, ...]:
        """Checks of one severity."""
        return tuple(check for check in self.checks if check.severity is severity)

    def corrected(self) -> Mapping[str, Correction]:
        """By name of the run: everything that can be mended in it, in one correction."""
        found: dict[str, Correction] = {}
        for check in self.wrong:
            if check.run is not None and check.correction is not None:
                found[check.run] = found.get(check.run, Correction()).then(check.correction)
        return found


MODEL = "M.toml"
"""Where a remedy names the model's file, which a check does not know."""


def listed(names: Sequence[str]) -> str:
    """Names for a sentence, of many the first and how many there are."""
    return ", ".join(names) if len(names) <= FEW else f"{names[0]} and {len(names) - 1} more"


FEW = 3
"""Names that a sentence holds."""


def by_severity(checks: Sequence[Check]) -> tuple[Check, ...]:
    """The worst first, in their order otherwise."""
    order = list(Severity)
    return tuple(sorted(checks, key=lambda check: order.index(check.severity)))


def amount(value: float) -> str:
    """A number with the digits that matter."""
    return f"{float(np.format_float_positional(value, 3, fractional=False)):g}"


class WrongRecordingError(TaskFailedError):
    """A recording is not what it says it is; `inspection` has all checks."""

    def __init__(self, inspection: "Inspection") -> None:
        self.inspection = inspection
        remedy = inspection.wrong[0].remedy
        super().__init__(inspection.sentence + (f" {remedy}." if remedy else "") + " --trust-data goes on regardless.")
