#!/usr/bin/env bash
# Makes the pictures of the README; needs `armdyn` and `chromium` on the path.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shoot() { # page, picture, height
    chromium --headless --no-sandbox --disable-gpu --hide-scrollbars --window-size="1280,$3" --virtual-time-budget=8000 \
        --screenshot="$2" "file://$1" 2>/dev/null
}
mkdir -p docs/pictures
armdyn trial --picture --out "$work/trial"
cp "$work/trial/swing.png" docs/pictures/swing.png
shoot "$work/trial/report.html" "$PWD/docs/pictures/trial_report.png" 1560
armdyn trial --hidden quadratic_drag=0.05 --picture --out "$work/miss" || true # it misses, which is what is shown
cp "$work/miss/swing.png" docs/pictures/swing_missed.png
armdyn repair "$work/miss/model.toml" "$work/miss/trial.csv" --output "$work/repaired.toml" --report "$work/repair.html"
shoot "$work/repair.html" "$PWD/docs/pictures/repair_report.png" 1500
armdyn trial --hidden quadratic_drag=0.05 --model "$work/repaired.toml" --picture --out "$work/land"
cp "$work/land/swing.png" docs/pictures/swing_repaired.png
