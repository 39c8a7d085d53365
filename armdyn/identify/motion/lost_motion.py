"""Judge a repair of an arm by its simulated motion."""

from dataclasses import replace

import numpy as np

from armdyn.identify.repair import Repair
from armdyn.identify.sentence import Verdict

DRIFTING = "window_5"
"""Windows in which the error of a simulation without position commands grows, also with the right model."""


def unless_lost(found: Repair) -> Repair:
    """A repair, with the verdict lost if its simulated motion is worse than that of joints at their commands.

    A motion that runs away is lost as well. Exam runs do not count.
    """
    errors = [e for e in found.after.rollout if e.role != "exam" and e.kind != DRIFTING]
    for role in ("held_out", "training"):
        own = [e for e in errors if e.role == role]
        away = next((e for e in own if e.rms is None), None)
        ours, told = (
            float(np.sqrt(np.mean([size**2 for size in sizes]))) if sizes and away is None else 0.0
            for sizes in (
                [e.rms or 0.0 for e in own if e.position_is_command],
                [e.position_is_command[0] for e in own if e.position_is_command],
            )
        )
        if away is None and ours <= told:
            continue
        where = "held-out" if role == "held_out" else "training"
        how = f"the simulated motion of {where} runs is off by {ours:.3g} rad, joints at their commands by {told:.3g}"
        if away is not None:
            how = f"the simulated {away.joint} runs away in {away.run}"
        advice = "state the drive's gain and limit, leave out runs with collisions, or record slower motions"
        return replace(found, verdict=Verdict.LOST, sentence=f"lost: {how}. So no value here says anything: {advice}.")
    return found
