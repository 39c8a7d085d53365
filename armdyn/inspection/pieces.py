"""The stretch of a run that the physics looks at."""

from dataclasses import replace

from armdyn.gaps import between, gaps_of
from armdyn.inspection.signals import steps_of
from armdyn.run import Run


def longest_piece(run: Run, seconds: float) -> Run:
    """The longest stretch without a gap or a step, of at most so many seconds, from its middle."""
    begin = min(float(c.time[0]) for c in run.channels.values())
    end = max(float(c.time[-1]) for c in run.channels.values())
    spans = sorted([*gaps_of(run), *((t, t) for t in steps_of(run))])
    if not spans and end - begin <= seconds:
        return run
    edges = [begin, *(t for span in spans for t in span), end]
    edges = [max(edges[: i + 1]) for i in range(len(edges))]
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda piece: piece[1] - piece[0])
    if last - first > seconds:
        middle = 0.5 * (first + last)
        first, last = middle - 0.5 * seconds, middle + 0.5 * seconds
    return replace(run, channels=between(run, first, last))
