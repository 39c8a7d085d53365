"""How a column says its unit: ``name [unit]``."""

import re

_LABEL = re.compile(r"(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]")


def name_and_unit(label: str) -> tuple[str, str]:
    """``"q.elbow [deg]"`` as ``("q.elbow", "deg")``; the unit is empty where none is written."""
    match = _LABEL.fullmatch(label.strip())
    return (match["name"].strip(), match["unit"].strip()) if match else (label.strip(), "")
