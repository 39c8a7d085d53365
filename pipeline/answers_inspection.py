"""Answer of inspect in the form of the contract; other commands have its checks too."""

from collections.abc import Sequence
from typing import Any

from armdyn.inspection.check import Check, Inspection


def inspection_answer(found: Inspection) -> dict[str, Any]:
    """JSON of `inspect`, and of every command that a recording's mistake has ended."""
    return {
        "schema": "armdyn.inspect/1",
        "usable": found.usable,
        "sentence": found.sentence,
        "recording_checks": checks_answer(found.checks),
    }


def checks_answer(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """The checks of any answer."""
    return [
        {
            "kind": check.kind,
            "severity": check.severity.key,
            "run": check.run,
            "channels": list(check.channels),
            "from": check.start,
            "to": check.end,
            "evidence": check.evidence,
            "sentence": check.sentence,
            "remedy": check.remedy,
        }
        for check in checks
    ]
