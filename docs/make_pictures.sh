#!/usr/bin/env bash
# Makes the pictures of the README; needs `armdyn` with its extra `workbench`, `python` and `chromium` on the path.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shoot() { # page, picture, height
    chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size="1280,$3" --virtual-time-budget=8000 \
        --screenshot="$2" "file://$1" 2>/dev/null
}
below_the_blank() { # picture of a page that was scrolled: what was passed is white
    python -c "
import sys, numpy, PIL.Image
picture = PIL.Image.open(sys.argv[1]).convert('RGB')
top = int(numpy.flatnonzero((numpy.asarray(picture) < 250).any(axis=(1, 2)))[0])
picture.crop((0, top, *picture.size)).save(sys.argv[1])" "$1"
}
mkdir -p docs/pictures
armdyn trial --picture --out "$work/trial"
cp "$work/trial/swing.png" "$work/trial/swing.gif" docs/pictures/
shoot "$work/trial/report.html" "$PWD/docs/pictures/trial_report.png" 1560
armdyn trial --hidden quadratic_drag=0.05 --picture --out "$work/miss" || true # it misses, which is what is shown
cp "$work/miss/swing.png" docs/pictures/swing_missed.png
armdyn repair "$work/miss/model.toml" "$work/miss/trial.csv" --output "$work/repaired.toml" --report "$work/repair.html"
shoot "$work/repair.html" "$PWD/docs/pictures/repair_report.png" 1500
armdyn trial --hidden quadratic_drag=0.05 --model "$work/repaired.toml" --picture --out "$work/land"
cp "$work/land/swing.png" docs/pictures/swing_repaired.png
armdyn trial --hidden pivot_viscous_friction --seed 2 --investigate 4 --out "$work/asked"
shoot "$work/asked/report.html#what-the-model-lacked" "$PWD/docs/pictures/investigation.png" 1930
below_the_blank "$PWD/docs/pictures/investigation.png"
armdyn import examples/ur5/*.csv --output "$work/runs" --guess --robot ur5
armdyn import examples/ur5/*.csv --output "$work/runs" --map "$work/runs/map.toml"
armdyn new arm "$work/ur5.toml" --robot ur5
armdyn repair "$work/ur5.toml" "$work/runs/sweep_1.csv" "$work/runs/sweep_2.csv" --held-out "$work/runs/pick_and_place.csv" \
    --output "$work/ur5_repaired.toml" --report "$work/arm.html"
python - "$work/runs/sweep_1.csv" "$work/sweep_3.csv" <<'EOF' # two columns exchanged, 1.2 s lost
import csv, sys
head, *rows = csv.reader(open(sys.argv[1]))
a, b = (head.index(f"tau.{joint} [N m]") for joint in ("shoulder_lift_joint", "elbow_joint"))
for row in rows:
    row[a], row[b] = row[b], row[a]
    row[1:] = row[1:] if not 6.0 < float(row[0]) < 7.2 else [""] * (len(row) - 1)
csv.writer(open(sys.argv[2], "w")).writerows([head, *rows])
EOF
armdyn inspect "$work/ur5.toml" "$work/runs/sweep_1.csv" "$work/sweep_3.csv" --report "$work/inspect.html" || true
shoot "$work/inspect.html" "$PWD/docs/pictures/inspect_report.png" 1250
PYTHONPATH=tests python - "$work" <<'EOF'
import sys
from pathlib import Path

from hidden_effects.lab import Change, Lab

changes = {1: Change(19, tool=0.1), 4: Change(12, dry_friction=1.25)}
Lab(robots=6, recordings=36, changes=changes).write(Path(sys.argv[1]) / "robots")
EOF
cat > "$work/lab.toml" <<'EOF'
task = "compare"
[[recordings]]
model = "robots/{robot}/model.toml"
runs = ["robots/{robot}/logs/*.csv"]
EOF
(cd "$work" && armdyn batch lab.toml --output lab)
shoot "$work/lab/report.html" "$PWD/docs/pictures/batch_report.png" 1560
shoot "$work/arm.html#tab=tau.elbow_joint" "$PWD/docs/pictures/arm_report.png" 1180
python docs/workbench_pictures.py "$work/runs" "$work/ur5.toml" docs/pictures
python benchmarks/real.py --pictures docs/pictures || true # where the public recordings are; some claims are missed
