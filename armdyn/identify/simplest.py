"""Which of several sets a reader should be told: what explains most, or what stands in for it with fewer values."""

from collections.abc import Sequence

import numpy as np

from armdyn.identify.appraisal import Appraisal

SAVED = 0.05
"""Share of the best effect's gain, as a logarithm of the error, that one may lack for each value that it saves: a
spring with two values and 0.76 of what a link with ten explains comes first, a gain with one and 0.88 of the spring
does not."""
NEARLY = 0.75
"""Share of that gain that it must bring, however many it saves."""
CORE = 0.5
"""The same where what the simpler effect lacks may come as an effect of its own: an offset beside Coulomb
friction in place of asymmetric friction. Also what is enough where what saves values is worth more."""


def simplest_of_best(now: Appraisal, options: Sequence[Appraisal]) -> Appraisal:
    """What explains most, or what stands in for it: it explains nearly as much with fewer values.

    What stands in is compared in its turn: two links, a link that does nearly as much, the payload that it imitates.
    """
    best = min(options, key=lambda o: o.overall)
    while True:
        near = [o for o in options if o is best or _stands_in(o, best, now)]
        simplest = min(near, key=lambda o: (np.sum(o.free), -o.worth))
        if np.sum(simplest.free) >= np.sum(best.free):
            return simplest
        best = simplest


def _stands_in(one: Appraisal, best: Appraisal, now: Appraisal) -> bool:
    """Whether a set is what a reader should be told in place of the one that explains most: it saves values.

    It must explain nearly as much; half is enough for what is worth more: a link does better than the payload behind it
    where it bends to small errors of other joints. Several effects do not stand for one: gains of four joints are no
    simpler than the one link that they imitate.
    """
    saved = float(np.sum(best.free) - np.sum(one.free))
    gain, most = (float(np.log(now.overall / o.overall)) for o in (one, best))
    surer = saved > 0.0 and one.worth > best.worth
    enough = CORE if surer else max(NEARLY, 1.0 - SAVED * saved)
    return len(one.effects) <= len(best.effects) and gain >= enough * most
