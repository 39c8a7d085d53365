"""Inverse kinematics side by side on the same targets: armdyn, pink, pytracik, scipy; cold targets and a line.

    python benchmarks/ik.py [--robot baxter] [--targets 200] [--quick] [--json FILE]

pink and pytracik are optional: pip install pin-pink 'qpsolvers[daqp]' pytracik
"""

import sys

if __name__ == "__main__":
    # This file has the name of the package that it measures: its directory must not be searched first.
    sys.path.append(sys.path.pop(0))
    from _ik_race import main

    raise SystemExit(main())
