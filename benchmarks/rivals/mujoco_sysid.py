"""A servo arm against MuJoCo's own system identification: the motion in held-out recordings, the time, the values.

    python benchmarks/rivals/mujoco_sysid.py [--data FOLDER] [--steps 15] [--quick] [--json FILE]

MuJoCo's toolbox is told which parameters are unknown: gain, viscous and dry friction and armature of every joint, the
delay, and the play. armdyn is told the kind of the servo alone, and chooses among all its effects. Both have the same
description and recordings, in one process and on one thread: of a SO-101 that MuJoCo simulates, where the truth is
known, and of a real one, if its recordings are found. The toolbox is optional: pip install 'mujoco[sysid]'
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
from _timing import DATA, Claim, conclude, print_table  # isort: skip

import argparse
import warnings
from dataclasses import asdict, dataclass
from time import process_time

import numpy as np
from _servo_cases import (
    FRICTIONS,
    GAIN_NAME,
    JOINTS,
    PLAY_NAME,
    RECORDED,
    SIMULATED,
    ServoCase,
    recorded,
    simulated,
)
from _sysid_fit import MissingSysidError, SysidFit, fit, toolbox

from armdyn.arm.closed_loop.rollout import simulated_position_errors
from armdyn.arm.drives import KNOWN_DRIVES
from armdyn.arm.model import ArmModel, arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.run import Run
from armdyn.threads import one_thread

KIND = "sts3215"
STEPS, QUICK_STEPS, QUICK_SECONDS = 15, 2, 8.0
RIVALS = {"mujoco.sysid": False, "mujoco.sysid, one gain": True}
"""Whether it is told that all servos have one gain, as armdyn takes it of a kind of servos."""
MOST = {SIMULATED: 1.25, RECORDED: 1.0}
"""Largest error of armdyn's motion over the toolbox's best. The simulated arm moves in the toolbox's own simulator, by
the very play that it is told of; in armdyn a drive carries its link also while it falls through its play."""


@dataclass(frozen=True)
class Found:
    """What armdyn found; see `SysidFit`."""

    values: dict[str, float]
    held_out: float
    training: float
    seconds: float
    named: str


def repaired(case: ServoCase) -> Found:
    """A repair of the described arm, which is told nothing but the kind of its servos."""
    begun = process_time()
    described = arm_model(case.urdf)
    table = {"joints": list(described.arm.joints), **KNOWN_DRIVES[KIND]}
    result = CheckedStudy.of(described.with_drives({KIND: table}), case.training, case.held_out).repair()
    seconds = process_time() - begun
    model = result.model.capability(ArmModel)
    assert model is not None
    servo = model.drives[KIND]
    values = {name: p.value for name, p in model.parameters.items() if p.effect}
    values |= {f"{GAIN_NAME}[{joint}]": servo.gain.value for joint in JOINTS if servo.gain is not None}
    values |= {"delay": servo.delay or 0.0}
    named = ", ".join(effect.name for effect in model.effects)
    return Found(values, _rms(model, case.held_out), _rms(model, case.training), seconds, named)


def _rms(model: ArmModel, runs: tuple[Run, ...]) -> float:
    """Error of the simulated positions of all joints [rad]; infinite where the motion is lost."""
    found = simulated_position_errors(model, [(run, "") for run in runs])
    return float(np.sqrt(np.mean(np.concatenate([(e.simulated - e.measured) ** 2 for e in found]))))


def compare(case: ServoCase, steps: int) -> dict[str, SysidFit | Found]:
    """Both answers; prints their errors and, where the truth is known, their values."""
    rivals = {name: fit(case, steps, one_gain=one) for name, one in RIVALS.items()}
    own = repaired(case)
    print_table(
        f"{case.name}: {len(case.training)} recordings fitted, {len(case.held_out)} held out",
        ["by", "told", "held out mrad", "fitted mrad", "held out / armdyn", "processor s", "time / armdyn"],
        [
            [name, told, f"{1e3 * one.held_out:.2f}", f"{1e3 * one.training:.2f}",
             f"{one.held_out / own.held_out:.2f}", f"{one.seconds:.0f}", f"{one.seconds / own.seconds:.2f}"]
            for name, told, one in (
                ("armdyn", "nothing", own),
                *((name, f"{rival.told} parameters", rival) for name, rival in rivals.items()),
            )
        ],
        texts=2,
    )  # fmt: skip
    print(f"armdyn names {own.named}")
    if case.truth:
        names = [GAIN_NAME, *FRICTIONS, PLAY_NAME]
        rows = [[name, f"{_true(case, name):g}", *(_off(one.values, case, name) for one in (own, *rivals.values()))]
                for name in names]  # fmt: skip
        print_table("Mean and largest error of the values, %", ["parameter", "truth", "armdyn", *RIVALS], rows)
    delays = ", ".join(f"{who} {1e3 * one.values['delay']:.1f} ms" for who, one in {"armdyn": own, **rivals}.items())
    print(f"delay{', none in truth' if case.truth else ''}: {delays}")
    return {"armdyn": own, **rivals}


def _true(case: ServoCase, name: str) -> float:
    return case.truth[name] if name in case.truth else case.truth[f"{name}[{JOINTS[0]}]"]


def _errors(values: dict[str, float], case: ServoCase, name: str) -> np.ndarray:
    """Relative errors of a parameter on the joints; 1 where it was not found."""
    places = [name] if name == PLAY_NAME else [f"{name}[{joint}]" for joint in JOINTS]
    return np.array([abs(values.get(place, 0.0) / _true(case, name) - 1.0) for place in places])


def _off(values: dict[str, float], case: ServoCase, name: str) -> str:
    errors = 100.0 * _errors(values, case, name)
    return f"{errors.mean():.1f}, {errors.max():.1f}"


@one_thread
def main() -> int:
    """Run both on each case, print the tables and check the claims; 1 where a claim is missed, 2 without the rival."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="less than a minute: checks answers, judges no ratio")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    parser.add_argument("--data", type=Path, default=DATA / "servo_so101", help="folder of the real arm's recordings")
    parser.add_argument("--steps", type=int, help=f"of MuJoCo's optimiser ({STEPS}; {QUICK_STEPS} with --quick)")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # of the description's inertias
    try:
        toolbox()
    except MissingSysidError as missing:
        print(missing, file=sys.stderr)
        return 2
    steps = options.steps or (QUICK_STEPS if options.quick else STEPS)
    cases = [simulated(QUICK_SECONDS) if options.quick else simulated()]
    if not options.quick and (options.data / "so101.urdf").exists():
        cases.append(recorded(options.data))
    elif not options.quick:
        print(f"no recordings of a real arm in {options.data}: --data FOLDER")
    print(f"at most {steps} steps of MuJoCo's optimiser")
    results = {case.name: compare(case, steps) for case in cases}
    judged = None if options.quick else True
    claims = [
        Claim(f"{name}: untold, at most {MOST[name]:g} times the error of what is told, in held-out recordings",
              f"{ratio:.2f}", judged and ratio <= MOST[name])
        for name, both in results.items()
        for ratio in [both["armdyn"].held_out / min(both[rival].held_out for rival in RIVALS)]
    ]  # fmt: skip
    plain = {name: {who: asdict(one) for who, one in both.items()} for name, both in results.items()}
    return conclude(claims, {"steps": steps, "cases": plain}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
