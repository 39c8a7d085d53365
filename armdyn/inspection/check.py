"""Findings of an inspection: what is wrong in a recording, where, how certain it is, and the remedy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from armdyn.errors import TaskFailedError
from armdyn.inspection.correction import Correction
from armdyn.run import Run

CheckKind: TypeAlias = Literal[
    "angle_unit", "torque_unit", "torque_sign", "position_sign", "joints_swapped", "position_offset", "clock_shift",
    "gravity_direction", "scale", "gap", "glitch", "counts_lost", "saturated", "frozen", "repeated_samples", "rate",
    "noise_misstated", "no_motion", "implausible_model", "samples_dropped", "second_publisher", "joint_left_out",
    "unusable", "wrapped", "filtered", "sign_missing", "without_gravity", "unanswered_check", "sticking",
    "wrench_sign", "wrench_frame", "wrench_zeroed",
]  # fmt: skip
MODEL_PLACEHOLDER = "M.toml"
"""Placeholder for the path of the model file in proposed command lines."""
MAX_LISTED_NAMES = 3
"""Largest number of names that a sentence lists."""


class Severity(Enum):
    """Severity of a finding; the value is its explanation in words."""

    WRONG = "the recording is not what it says: correct it first"
    SUSPECT = "look at it before you believe what follows"
    NOTE = "handled, and worth knowing"

    @property
    def key(self) -> str:
        """Key of the severity in JSON."""
        return self.name.lower()


@dataclass(frozen=True)
class Check:
    """One finding on a recording, or on a model that was fitted to it.

    Attributes:
        kind: kind of the finding in one word.
        severity: severity of the finding.
        run: name of the run; None for a finding on a model.
        channels: channels concerned.
        sentence: what is wrong, where, and how certain it is.
        remedy: what to do, as a command line if possible.
        start: time at which the fault begins, s; None for the whole run.
        end: time at which the fault ends, s.
        evidence: log ratio, in nats, of the recording's probability with this mistake to that under the next best
            hypothesis; None for a check without hypotheses.
        correction: correction of the recording; None if only a new recording helps.
    """

    kind: CheckKind
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
    """All findings on some recordings, the worst first.

    Attributes:
        runs: the recordings.
        checks: findings on them.
    """

    runs: tuple[Run, ...]
    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        return f"Inspection: {self.sentence}"

    @property
    def wrong(self) -> tuple[Check, ...]:
        """Findings that make the recordings unusable."""
        return self.with_severity(Severity.WRONG)

    @property
    def usable(self) -> bool:
        """Whether the recordings can be compared with a model as they are."""
        return not self.wrong

    @property
    def sentence(self) -> str:
        """Sentence with the worst finding, or that the recordings are as declared."""
        worst = self.wrong or self.with_severity(Severity.SUSPECT)
        if not worst:
            return f"The recording{'s are what they say they are' if len(self.runs) > 1 else ' is what it says'}."
        where = f"{worst[0].run}: " if worst[0].run else ""
        more = f" ({len(worst) - 1} more of this kind.)" if len(worst) > 1 else ""
        return f"{where}{worst[0].sentence}{more}"

    def with_model_path(self, model: Path) -> "Inspection":
        """A copy of the findings with the path of the model file in their command lines."""
        named = (replace(c, remedy=c.remedy.replace(MODEL_PLACEHOLDER, str(model))) for c in self.checks)
        return replace(self, checks=tuple(named))

    def with_severity(self, severity: Severity) -> tuple[Check, ...]:
        """Findings of one severity."""
        return tuple(check for check in self.checks if check.severity is severity)

    def corrected(self) -> Mapping[str, Correction]:
        """Correction of each run that can be corrected, by the run's name."""
        found: dict[str, Correction] = {}
        for check in self.wrong:
            if check.run is not None and check.correction is not None:
                found[check.run] = found.get(check.run, Correction()).followed_by(check.correction)
        return found


def names_in_words(names: Sequence[str]) -> str:
    """Join names for a sentence; of many names only the first and the number of the others."""
    return ", ".join(names) if len(names) <= MAX_LISTED_NAMES else f"{names[0]} and {len(names) - 1} more"


def sorted_by_severity(checks: Sequence[Check]) -> tuple[Check, ...]:
    """Sort findings by severity, the worst first."""
    return tuple(sorted(checks, key=lambda check: list(Severity).index(check.severity)))


def rounded(value: float) -> str:
    """A number as text, with three significant digits."""
    return f"{float(np.format_float_positional(value, 3, fractional=False)):g}"


class WrongRecordingError(TaskFailedError):
    """A recording is not what it is declared to be; the attribute `inspection` contains all findings."""

    def __init__(self, inspection: "Inspection") -> None:
        self.inspection = inspection
        remedy = inspection.wrong[0].remedy
        super().__init__(inspection.sentence + (f" {remedy}." if remedy else "") + " --trust-data goes on regardless.")
