"""How much more information has a designed motion of Baxter's arm than random ones or one of least condition number?

    python benchmarks/excite.py
    python benchmarks/excite.py --what friction_and_payload --verify 8
    python benchmarks/excite.py --what spring_or_offset,payload_or_link --diagnose 6

All motions take 20 s and stay within the same shares of the same limits: positions, speeds, accelerations, torques, no
links that touch, no singularity. Random ones are Fourier series of 4 to 20 harmonics up to 1 Hz about random centres,
as large as the limits allow; the best of 100 counts. The motion of least condition number comes from the same search
over the same series with the cost of FloBaRoID and FIGAROH: the condition number of the regression on base parameters.

`expected` is what the Fisher information says. With `--verify` the motions are recorded by a plant that shares no code
with armdyn (`tests/worlds/baxter.py`: rigid bodies by MuJoCo, friction with a sharp sign), and armdyn fits the
recordings: `found` is the error against the truth over noise seeds. Torque noise is white, 0.2 % of each limit.
Positions are exact in one row and have an encoder's 0.4 mrad in the other.

With `--diagnose` a small effect is hidden in recordings of the motions for rivals, and `diagnose` says what it is: how
often the first name is right, without a tie.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import _timing
import numpy as np
from _hidden_table import JOINT_EFFECTS, generator

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.experiments.goal import MotionGoal, goal_to_determine, goal_to_separate
from armdyn.experiments.series import FourierSeries
from armdyn.identify.diagnose import diagnose
from armdyn.identify.estimator import estimate
from armdyn.identify.studies import make_study
from armdyn.run import Channel, Run
from pipeline.answers_motion import excitation_sentence, std_ratios_to_designed_motion
from pipeline.motion.excitation import Excitation, ExpectedMotionInformation, design_excitation

hidden_arm = generator("baxter")

SECONDS, RATE = 20.0, 100.0
DETERMINE = {
    "friction_and_payload": "joint_viscous_friction joint_coulomb_friction payload",
    "friction": "joint_viscous_friction joint_coulomb_friction",
    "everything_usual": "",
}
SEPARATE = {
    "spring_or_offset": ("gravity_spring", "torque_offset"),
    "payload_or_link": ("payload", "link_inertia"),
    "rotor_or_link": ("rotor_inertia", "link_inertia"),
}
SIZES = {"gravity_spring": 0.02, "torque_offset": 0.2, "payload": 0.05, "link_inertia": 0.1}
"""Sizes of the realistic effects, so small that a poor motion does not determine them."""


@dataclass(frozen=True)
class Moved:
    """Motion in the form that the plant takes."""

    series: FourierSeries
    coefficients: np.ndarray

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations at times."""
        found = self.series.basis_at(time).motion(self.coefficients)
        return found.q, found.v, found.a


def contenders(found: Excitation) -> Iterator[tuple[str, ExpectedMotionInformation]]:
    yield "designed", found.expected
    if found.random is not None:
        yield "best random", found.random
    if found.conditioned is not None:
        yield "least condition number", found.conditioned


def goal_of(name: str) -> MotionGoal:
    model = arm_model(robot="baxter")
    if name in DETERMINE:
        return goal_to_determine(model, [find(n) for n in DETERMINE[name].split()], RATE)
    first, second = map(find, SEPARATE[name])
    return goal_to_separate(model, first, second, RATE)


def recorded(found: Excitation, path: Moved, hidden: tuple[str, ...], size: float, seed: int, encoder: float) -> Run:
    """Recording of the independent plant, with the torque noise of the design."""
    clean = hidden_arm.generate(hidden, size, seed, duration=SECONDS, rate=RATE, noise=0.0, stated=False, path=path)
    rng = np.random.default_rng([seed, 7])
    channels, noise = {}, {}
    for name, channel in clean.channels.items():
        joint = hidden_arm.JOINTS.index(name.partition(".")[2])
        std = encoder if name.startswith("q.") else float(found.goal.columns.noise[joint])
        channels[name] = Channel(channel.time, channel.value + std * rng.standard_normal(len(channel)), channel.unit)
        if name.startswith("tau."):
            noise[name] = std
    return Run(f"seed {seed}", channels, noise=noise)


def errors(found: Excitation, motion: ExpectedMotionInformation, seeds: int, encoder: float) -> np.ndarray:
    """Root mean square errors (W,) of the unknowns of the design after armdyn's fit."""
    goal = found.goal
    model = goal.columns.model
    wanted = [goal.columns.unknowns[i] for i in goal.wanted]
    hidden = tuple(dict.fromkeys(p.effect for p in wanted))
    truth = {k: v for name in hidden for k, v in hidden_arm.true_parameters(name, 1.0).items()}
    collected = []
    for seed in range(seeds):
        run = recorded(found, Moved(found.series, motion.coefficients), hidden, 1.0, seed, encoder)
        prepared = model.prepare_run(run)
        found_values = estimate(model, [prepared], prepared.noise)
        collected.append([found_values.value(p.name) - truth[p.name] for p in wanted])
    return np.sqrt(np.mean(np.square(collected), axis=0))


def mean_ratio(worse: np.ndarray, better: np.ndarray) -> float:
    return float(np.exp(np.mean(np.log(worse / better))))


def verify(found: Excitation, seeds: int) -> dict:
    rows, answer = [], {}
    for label, encoder in (("exact positions", 0.0), ("0.4 mrad encoders", 4e-4)):
        by = {name: errors(found, e, seeds, encoder) for name, e in contenders(found)}
        for name, e in contenders(found):
            against = mean_ratio(by[name], by["designed"])
            rows.append([f"{name}, {label}", f"{mean_ratio(by[name], e.std):.2f}", f"{against:.2f}"])
        answer[label] = {name: values.tolist() for name, values in by.items()}
    _timing.print_table(
        f"fits of {seeds} recordings by the independent plant, geometric means over unknowns",
        ["motion", "found error / expected", "error / designed"], rows,
    )  # fmt: skip
    return answer


def named(found: Excitation, motion: ExpectedMotionInformation, truth: str, seed: int) -> tuple[bool, bool]:
    """Whether the first name is right without a tie, and whether it or a reported tie contains the truth."""
    path = Moved(found.series, motion.coefficients)
    run = recorded(found, path, (truth,), SIZES[truth], seed, 4e-4)
    said = diagnose(make_study(arm_model(robot="baxter"), [run], [], JOINT_EFFECTS))
    first = said.ranked_effects[0].effect if said.ranked_effects else ""
    tied = said.ranked_effects[0].tied_with if said.ranked_effects else ()
    right = first == truth and said.verdict.key == "effect_missing"
    return right, right or truth in (first, *tied)


def diagnosed(found: Excitation, seeds: int) -> dict:
    rows, answer = [], {}
    for truth in dict.fromkeys(case.effect for case in found.goal.separations):
        for name, motion in contenders(found):
            results = [named(found, motion, truth, seed) for seed in range(seeds)]
            right, honest = (sum(column) for column in zip(*results, strict=True))
            rows.append([truth, name, f"{right} of {seeds}", f"{honest} of {seeds}"])
            answer[f"{truth}, {name}"] = [right, honest, seeds]
    _timing.print_table("diagnosed", ["hidden", "motion", "named, no tie", "or an honest tie"], rows, 2)
    return answer


def separations(found: Excitation) -> list[list[str]]:
    rows = []
    for k, case in enumerate(found.goal.separations):
        cells = [f"{e.separations[k] ** 0.5:.3g}" for _, e in contenders(found)]
        rows.append([case.effect, case.joint, *cells])
    return rows


def report(name: str, found: Excitation, seconds: float) -> tuple[dict, list[_timing.Claim]]:
    """Print the expected errors; return them, and the claims about them."""
    print(
        f"\n{name}: {excitation_sentence(found)}\n"
        f"  {found.feasibility.sentence} {seconds:.0f} s of the processor to design all."
    )
    goal = found.goal
    if goal.rivals:
        headings = ["hidden", "joint", *(label for label, _ in contenders(found))]
        _timing.print_table("separation in standard deviations, typical size", headings, separations(found), 2)
        least = {label: min(e.separations) ** 0.5 for label, e in contenders(found)}
        told = least["designed"] >= max(2.0 * least["best random"], 1.0)
        claim = _timing.Claim(f"{name}: smallest separation at least twice the best random one's", str(least), told)
        return {"least": least, "rows": separations(found)}, [claim]
    against = dict(zip(("best random", "least condition number"), std_ratios_to_designed_motion(found), strict=True))
    rows = []
    for k, i in enumerate(goal.wanted):
        p = goal.columns.unknowns[i]
        if i in goal.unidentifiable or len(goal.wanted) > 30:
            continue
        rows.append([p.name, *(f"{e.std[k]:.3g}" for _, e in contenders(found)), p.unit])
    if rows:
        headings = ["unknown", *(label for label, _ in contenders(found)), "unit"]
        _timing.print_table("expected standard deviations", headings, rows)
    claims = []
    if name == "friction_and_payload":
        better = against["best random"]
        what = f"{name}: standard deviations at least 2 times smaller than the best random motion's"
        claims.append(_timing.Claim(what, f"{better:.2f} times (geometric mean)", better >= 2.0))
    return {"factor": against, "std": {label: e.std.tolist() for label, e in contenders(found)}}, claims


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = [*DETERMINE, *SEPARATE]
    parser.add_argument("--what", default=",".join(everything), help=f"with commas, of {', '.join(everything)}")
    parser.add_argument("--random", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the random motions")
    parser.add_argument("--verify", type=int, default=0, metavar="SEEDS", help="recordings to simulate and to fit")
    parser.add_argument("--diagnose", type=int, default=0, metavar="SEEDS", help="recordings with a small effect")
    parser.add_argument("--json", type=Path, default=None)
    given = parser.parse_args()
    results, claims = {}, []
    for name in given.what.split(","):
        began = time.process_time()
        found = design_excitation(goal_of(name), SECONDS, random=given.random, seed=given.seed)
        results[name], new = report(name, found, time.process_time() - began)
        claims += new
        if given.verify and not found.goal.rivals:
            results[name]["verified"] = verify(found, given.verify)
        if given.diagnose and found.goal.rivals and {c.effect for c in found.goal.separations} <= set(SIZES):
            results[name]["diagnosed"] = diagnosed(found, given.diagnose)
        if given.json is not None:
            given.json.write_text(json.dumps(results, indent=1, default=float))
    return _timing.conclude(claims, results, given.json)


if __name__ == "__main__":
    raise SystemExit(main())
