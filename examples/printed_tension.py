"""Is a published formula right? The tension as printed in a paper, as an effect whose share the load cell decides.

```console
$ armdyn add model.toml swing.csv printed_tension --effects examples/printed_tension.py --output asked.toml
```

A share of 1 is the printed formula, a share of 0 the one that follows from the equations of motion.
"""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity


@effect(acts_on="tension", summary="The tension as printed.", source="Wilson et al., IEEE T-ASE 2016")
def printed_tension(tension, share=quantity("1", typical=1.0, lower=-1.0, upper=2.0)):
    """T = m g cos(phi) - m l phi'^2 - u sin(phi): two wrong signs, and one mass is missing."""
    t, phi = tension, tension.angle
    printed = t.mass * (t.gravity * ca.cos(phi) - t.length * t.rate**2) - t.acceleration * ca.sin(phi)
    return t.with_value((1 - share) * t.value + share * printed)
