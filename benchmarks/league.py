"""Rebuild the table of docs/league.md: public recordings, armdyn's error and that of others on the same runs.

    python benchmarks/league.py --data DIR --write docs/league.md

DIR holds a folder for each set, under the names of `real.py` and `real_arms.py`; sets that are missing keep their rows.
Errors are those of runs that were not fitted: of the exam where there is one, else of the held-out runs.
"""

import re
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import _timing as bench
import real
import real_arms

HEADINGS = (
    "recording, licence", "measured", "unit", "as given", "armdyn", "others", "armdyn / others", "names", "rebuild",
)  # fmt: skip
BEGIN, END = "<!-- rows of benchmarks/league.py -->", "<!-- end of rows -->"


@dataclass(frozen=True)
class Published:
    """Where a set comes from, and who else has fitted it.

    Attributes:
        link: address of its repository.
        licence: licence of the recordings.
        measured: what was recorded.
        by: whose error stands beside armdyn's.
    """

    link: str
    licence: str
    measured: str
    by: str = "a fit by hand"


GITHUB = "https://github.com/"
PUBLISHED: Mapping[str, Published] = {
    "multiarm_pendulum": Published(GITHUB + "dynamicslab/MultiArm-Pendulum", "MIT", "angle, encoder, 1 kHz"),
    "freeswing_1khz": Published(GITHUB + "jensen-benard/rotary-inverted-pendulum", "MIT", "angle, encoder, 1 kHz"),
    "pend_cup_video": Published(GITHUB + "tylertian123/phy180_lab", "MIT", "angle, phone video, 20 Hz"),
    "pend_heavy_bob": Published(GITHUB + "JLefebvre55/PHY180-Pendulum", "MIT", "angle, video, 12 Hz"),
    "pend_fork_gyro": Published(GITHUB + "moorepants/BicycleParameters", "BSD-2-Clause", "rate, gyro, 100 Hz"),
    "pend_wheel_gyro": Published(GITHUB + "moorepants/resonance", "MIT", "rate, gyro, 100 Hz"),
    "arm_dfki_double": Published(
        GITHUB + "dfki-ric-underactuated-lab/double_pendulum", "BSD-3-Clause", "2 joints: q, v, torque, 250 Hz"
    ),
    "arm_gen3": Published(GITHUB + "SedkiLmm/dynamic-identification", "MIT", "7 joints: q, v, current, 250 Hz"),
    "arm_panda_unisa": Published(
        GITHUB + "unisa-acg/inverse-dynamics-solver", "BSD-3-Clause", "7 joints: q, v, torque, 30 Hz"
    ),
    "emps": Published("https://www.nonlinearbenchmark.org", "to be cited", "a slide: q, force, 1 kHz"),
    "ur10e": Published(
        GITHUB + "shamilmamedov/dynamic_calibration", "none: not to be passed on", "6 joints: q, v, current"
    ),
}


def rows(data: Path) -> Iterator[tuple[str, list[str]]]:
    """Cells of each set that is in the folder, by its name."""
    for pendulum in real.SETS:
        if (data / pendulum.folder).is_dir():
            found, _ = real.answered(pendulum, data)
            last = "exam" if pendulum.by_hand.exam is not None else "held_out"
            given, ours = (1e3 * error for error in found[last])
            hand = 1e3 * (pendulum.by_hand.exam or pendulum.by_hand.held_out)
            unit = "mrad" if pendulum.channel == "swing_angle" else "mrad/s"
            names = ", ".join(f"`{name}`" for name in found["effects"])
            command = f"`real.py --only {pendulum.name}`"
            yield pendulum.folder, cells(pendulum.folder, unit, given, ours, hand, names, command)
    for arm in real_arms.SETS:
        if (data / arm.folder).is_dir():
            _, names, _, before, after, hand, _ = real_arms.examine(arm, data)
            given, ours = (float(errors.split(", ")[1]) for errors in (before, after))
            unit = "N" if arm.folder == "emps" else "N m"
            yield arm.folder, cells(arm.folder, unit, given, ours, float(hand or "nan"), names, "`real_arms.py`")


def cells(folder: str, unit: str, given: float, ours: float, others: float, names: str, command: str) -> list[str]:
    """Cells of a row, from errors in `unit`; `others` may be nan."""
    about = PUBLISHED[folder]
    known = others == others
    return [
        f"[{folder}]({about.link}), {about.licence}", about.measured, unit, f"{given:.3g}", f"{ours:.3g}",
        f"{others:.3g}, {about.by}" if known else "nobody has published one", f"{ours / others:.2f}" if known else "",
        names, command,
    ]  # fmt: skip


def main() -> None:
    """Print the table, and write it into the page."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=bench.DATA, help="folder with the sets")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="page whose table is rebuilt")
    options = parser.parse_args()
    if not options.data.is_dir():
        raise SystemExit(f"{options.data}: there is no such folder: give --data")
    found = dict(rows(options.data))
    bench.print_table("public recordings", HEADINGS, list(found.values()), texts=3)
    if options.write is None:
        return
    page = options.write.read_text(encoding="utf-8")
    before, kept, after = re.split(f"{re.escape(BEGIN)}|{re.escape(END)}", page)
    known = {m[1]: m[0] for m in re.finditer(r"^\| \[(\w+)\].*$", kept, re.MULTILINE)}
    known |= {name: f"| {' | '.join(row)} |" for name, row in found.items()}
    head = f"| {' | '.join(HEADINGS)} |\n|---|---|---|--:|--:|---|--:|---|---|"
    options.write.write_text(
        f"{before}{BEGIN}\n{head}\n" + "\n".join(known.values()) + f"\n{END}{after}", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
