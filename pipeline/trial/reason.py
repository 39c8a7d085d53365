"""Why a trial ended, in one sentence for a person, whatever was raised."""

import traceback

from armdyn.errors import ArmdynError

LONGEST = 300
"""Characters of a foreign message that are shown; some hold whole matrices."""


def sentence_of(error: BaseException, where: str, time: float) -> str:
    """What happened, in one line.

    Our own errors already say what to do. Of any other, the kind, its message and the place in the code are given:
    that is what whoever mends it needs.

    Args:
        error: what was raised.
        where: what was running, such as ``"the estimator node"``.
        time: when [s].
    """
    if isinstance(error, ArmdynError):
        return _one_line(str(error))
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({frames[-1].filename.rpartition('/')[2]}, line {frames[-1].lineno})" if frames else ""
    said = _one_line(str(error))
    return f"{where} failed at {time:.2f} s: {type(error).__name__}{': ' if said else ''}{said}{place}"


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else line[:LONGEST] + " ..."
