"""Which effects does armdyn find in public recordings of real pendulums, and how good is it beside a fit by hand?

    python benchmarks/real.py --data DIR --pictures docs/pictures

The recordings are not in the repository; `docs/real.md` says where each comes from. For each set a pendulum of 0.35 m
and 0.1 kg, `armdyn new pendulum` as it is, is repaired with the training runs; held-out runs take part in choosing,
exams in nothing. Every run has its own start. Columns:

- first: the effect that is named first, and in brackets those that the runs cannot tell from it;
- set: all effects of the repaired model, in the order in which they came;
- as given, repaired: rms error of the channel that the fit by hand was made for, on training, held-out and exam runs;
- by hand: the same of the best structure that a person found with plain output error, with no code of armdyn;
- held out / by hand: below 1 armdyn predicts the held-out run better;
- same structure: errors of armdyn's fit of the structure found by hand, as by `armdyn add`. If they are smaller than
  those of the repaired model, the search has chosen worse effects.

`--pictures` writes what the model lacks against speed and angle, one picture for each set; it needs `chromium`.
"""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import _timing as bench

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import ArmdynError
from armdyn.identify.repair import Repair, add, repair
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.parameter import Parameter
from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.physics import STANDARD_GRAVITY
from armdyn.run import read_run

LENGTH, MASS = 0.35, 0.1
"""Length [m] and mass [kg] of every model as given."""
CLOSE = 1.1
"""Held-out error over that of the fit by hand, up to which a repair counts as good."""
QUICK = "wheel"
SHOWN = ("speed", "angle")
PICTURE = (1000, 372)
"""Size of the picture in pixels."""
COLOURS = 64


@dataclass(frozen=True)
class ByHand:
    """Best structure that a person found by an output-error fit.

    Attributes:
        effects: names of its effects in the catalogue.
        training: rms error in the training runs, in the unit of the channel.
        held_out: rms error in the held-out runs, with their starts fitted.
        exam: rms error in the exam runs; None if unknown.
        source: file beside the recordings with these errors.
    """

    effects: tuple[str, ...]
    training: float
    held_out: float
    exam: float | None
    source: str


@dataclass(frozen=True)
class Recorded:
    """Set of recordings of one pendulum.

    Attributes:
        name: name in the table and of the figure's file.
        folder: subfolder of the data folder.
        channel: channel of the listed errors.
        training: names of the training files, without ending.
        held_out: names of the held-out files.
        exam: names of the exam files.
        by_hand: fit by hand.
    """

    name: str
    folder: str
    channel: str
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    exam: tuple[str, ...]
    by_hand: ByHand


CAMERA = ("angle_offset", "angle_gain", "angle_skew", "angle_distortion")
SETS = (
    Recorded(
        "multiarm", "multiarm_pendulum", "swing_angle",
        ("single_identification",), ("single_validation",), ("single_small_swing",),
        ByHand(("pivot_coulomb_friction", "quadratic_drag"), 2.6e-3, 11.8e-3, 2.3e-3, "expected.md"),
    ),
    Recorded(
        "freeswing", "freeswing_1khz", "swing_angle", ("free_swing_1", "free_swing_2"), ("free_swing_3",), (),
        ByHand(("pivot_viscous_friction", "pivot_coulomb_friction"), 20.3e-3, 6.7e-3, None, "expected.md"),
    ),
    Recorded(
        "cup", "pend_cup_video", "swing_angle", ("train",), ("heldout",), ("large",),
        ByHand(("quadratic_drag", "pivot_viscous_friction", *CAMERA), 4.54e-3, 3.96e-3, None, "PROVENANCE.md"),
    ),
    Recorded(
        "heavy_bob", "pend_heavy_bob", "swing_angle", ("train",), ("heldout",), ("early",),
        ByHand(
            ("pivot_viscous_friction", "quadratic_drag", "angle_offset"), 10.9e-3, 17.3e-3, 53e-3, "PROVENANCE.md"
        ),
    ),
    Recorded(
        "fork", "pend_fork_gyro", "swing_rate", ("train",), ("heldout",), (),
        ByHand(
            ("sensor_bias", "pivot_viscous_friction", "pivot_coulomb_friction"), 15.8e-3, 24.9e-3, None, "PROVENANCE.md"
        ),
    ),
    Recorded(
        "wheel", "pend_wheel_gyro", "swing_rate", ("train",), ("heldout",), (),
        ByHand(("sensor_bias",), 9.92e-3, 7.56e-3, None, "PROVENANCE.md"),
    ),
)  # fmt: skip


def answered(recorded: Recorded, data: Path) -> tuple[dict[str, object], Repair]:
    """Row of the table for one set, and the repair."""

    def runs(stems: Sequence[str]) -> list:
        return [read_run(data / recorded.folder / f"{stem}.csv") for stem in stems]

    training, held_out, exam = map(runs, (recorded.training, recorded.held_out, recorded.exam))

    def study() -> Study:
        return make_study(pendulum_model(LENGTH, MASS), training, held_out, list(CATALOGUE.values()), exam=exam)

    begun = time.process_time()
    found = repair(study())
    seconds = time.process_time() - begun
    same = add(study(), [CATALOGUE[name] for name in recorded.by_hand.effects])
    given, last = found.path[0], found.path[-1]
    first = found.path[1] if len(found.path) > 1 else given
    channel, hand = recorded.channel, recorded.by_hand

    def errors(kind: str) -> tuple[float | None, float | None]:
        return tuple(getattr(step, kind).get(channel) for step in (given, last))

    row = {
        "set": recorded.name,
        "channel": channel,
        "first": list(first.added),
        "tied": list(first.tied_with),
        "effects": [name for step in found.path[1:] for name in step.added],
        "training": errors("rmse"),
        "held_out": errors("held_out_rmse"),
        "exam": errors("exam_rmse"),
        "by_hand": {"effects": hand.effects, "errors": (hand.training, hand.held_out, hand.exam), "in": hand.source},
        "same_structure": [getattr(same.path[-1], k).get(channel) for k in ("rmse", "held_out_rmse", "exam_rmse")],
        "same_structure_accelerations": accelerations(same.after.parameters),
        "ratio": last.held_out_rmse[channel] / hand.held_out,
        "seconds": seconds,
        "verdict": found.verdict.key,
        "sentence": found.sentence,
        "accelerations": accelerations(found.after.parameters),
        "steps": [
            {"added": step.added, "tied": step.tied_with, "training": step.rmse.get(channel),
             "held_out": step.held_out_rmse.get(channel), "exam": step.exam_rmse.get(channel)}
            for step in found.path
        ],
    }  # fmt: skip
    return row, found


def accelerations(parameters: dict[str, Parameter]) -> dict[str, tuple[float, str]]:
    """Accelerations by the effects: forces over the inertia m l^2, as an angle does not determine the mass."""
    length, mass = parameters["length"].value, parameters["mass"].value
    inertia = mass * length**2
    known = {
        "pivot_coulomb_friction.torque": (1 / inertia, "rad/s^2"),
        "pivot_load_friction.radius": (STANDARD_GRAVITY / length**2, "rad/s^2 hanging at rest"),
        "pivot_viscous_friction.coefficient": (1 / inertia, "1/s"),
        "linear_drag.coefficient": (1 / mass, "1/s"),
        "quadratic_drag.coefficient": (length / mass, "1/rad"),
        "pivot_stiffness.stiffness": (1 / inertia, "1/s^2"),
    }
    found = {"gravity / length": (STANDARD_GRAVITY / length, "1/s^2")}
    for name, p in parameters.items():
        scale, unit = known.get(name, (1.0, p.unit))
        if "." in name and "[" not in name:
            found[name] = (p.value * scale, unit)
    return found


def picture(recorded: Recorded, found: Repair, folder: Path) -> Path:
    """PNG in few colours of the missing force over speed and angle, of the model as given and repaired."""
    import plotly.graph_objects as go
    from PIL import Image

    from pipeline.report.missing_force import missing_force_charts
    from pipeline.report.theme import PLOTLY_TEMPLATE

    effects = ", ".join(name for step in found.path[1:] for name in step.added)
    curves = [curve for curve in found.missing_force if curve.against in SHOWN]
    (drawn,) = missing_force_charts(curves, f"with {effects}")
    figure = go.Figure(drawn.figure)
    figure.update_layout(template=PLOTLY_TEMPLATE, width=PICTURE[0], height=PICTURE[1])
    target = folder / f"real_{recorded.name}.png"
    with tempfile.TemporaryDirectory() as work:
        page = Path(work) / "page.html"
        html = figure.to_html(include_plotlyjs=True, config={"staticPlot": True})
        page.write_text(html.replace("<body>", "<body style='margin: 0'>"), encoding="utf-8")
        subprocess.run(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--window-size={PICTURE[0]},{PICTURE[1]}", "--virtual-time-budget=8000",
             f"--screenshot={target.resolve()}", page.as_uri()],
            check=True, capture_output=True,
        )  # fmt: skip
    Image.open(target).convert("RGB").quantize(COLOURS).save(target, optimize=True)
    return target


def show(rows: Sequence[dict]) -> None:
    """Print tables of errors [mrad] or [mrad/s], of names and of values."""

    def small(value: float | None) -> str:
        return "" if value is None else f"{float(f'{1e3 * value:.3g}'):g}"

    def change(pair: Sequence[float | None]) -> str:
        return " -> ".join(map(small, pair)) if pair[0] is not None else ""

    units = {"swing_angle": "mrad", "swing_rate": "mrad/s"}
    bench.print_table(
        "Errors, as given -> repaired",
        ("set", "unit", "training", "held out", "exam", "by hand: training", "held out", "exam",
         "held out / by hand", "same structure: training", "held out", "exam", "processor s"),
        [
            (row["set"], units[row["channel"]], *(change(row[kind]) for kind in ("training", "held_out", "exam")),
             *map(small, row["by_hand"]["errors"]), f"{row['ratio']:.2f}", *map(small, row["same_structure"]),
             f"{row['seconds']:.1f}")
            for row in rows
        ],
        texts=2,
    )  # fmt: skip
    bench.print_table(
        "Names",
        ("set", "first", "all", "by hand"),
        [
            (row["set"], ", ".join(row["first"]) + (f" ({', '.join(row['tied'])})" if row["tied"] else ""),
             ", ".join(row["effects"]), ", ".join(row["by_hand"]["effects"]))
            for row in rows
        ],
        texts=4,
    )  # fmt: skip
    for row in rows:
        print(f"\n{row['set']}: {row['sentence']}")
        for title, key in (("", "accelerations"), (", same structure", "same_structure_accelerations")):
            for name, (value, unit) in row[key].items():
                print(f"  {name + title:48s}{value:12.4g} {unit}")
        for step in row["steps"]:
            errors = ", ".join(small(step[kind]) or "-" for kind in ("training", "held_out", "exam"))
            print(f"  + {', '.join(step['added']) or 'as given':46s}{errors}")


def claims(rows: Sequence[dict]) -> list[bench.Claim]:
    fallen = [row["set"] for row in rows if row["held_out"][1] < row["held_out"][0]]
    close = [row["set"] for row in rows if row["ratio"] <= CLOSE]
    sizes = ", ".join(f"{row['set']} {row['ratio']:.2f}" for row in rows)
    found = [
        bench.Claim("the held-out error falls in every set", f"{len(fallen)} of {len(rows)}", len(fallen) == len(rows)),
        bench.Claim(
            f"the held-out error is at most {CLOSE} of that of the fit by hand",
            f"{len(close)} of {len(rows)}: {sizes}",
            len(close) == len(rows),
        ),
    ]
    exams = [row for row in rows if row["exam"][0] is not None]
    if exams:
        better = sum(row["exam"][1] < row["exam"][0] for row in exams)
        found.append(bench.Claim("the exam's error falls", f"{better} of {len(exams)}", better == len(exams)))
    return found


def main() -> int:
    parser = bench.argparse.ArgumentParser(
        description=__doc__, formatter_class=bench.argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=bench.DATA, metavar="DIR", help="the folder that holds the sets")
    parser.add_argument("--only", default="", help="names of sets, with commas")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write a picture of what each model lacks")
    parser.add_argument("--quick", action="store_true", help=f"'{QUICK}' only, in a few seconds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    names = [QUICK] if options.quick else [name for name in options.only.split(",") if name]
    unknown = [name for name in names if name not in {one.name for one in SETS}]
    if unknown:
        parser.error(f"--only {unknown[0]}: choose from {', '.join(one.name for one in SETS)}")
    wanted = [one for one in SETS if not names or one.name in names]
    missing = [one.folder for one in wanted if not (options.data / one.folder).is_dir()]
    if missing:
        parser.exit(2, f"{options.data / missing[0]} is missing: get the recordings (docs/real.md), then give --data\n")
    if options.pictures is not None:
        if shutil.which("chromium") is None:
            parser.exit(2, "--pictures needs Chromium: apt-get install chromium\n")
        options.pictures.mkdir(parents=True, exist_ok=True)
    rows = []
    for recorded in wanted:
        try:
            row, found = answered(recorded, options.data)
        except ArmdynError as error:
            parser.exit(2, f"{error}\n")
        rows.append(row)
        if options.pictures is not None:
            print(f"{picture(recorded, found, options.pictures)}", flush=True)
    show(rows)
    return bench.conclude(claims(rows), {"rows": rows}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
