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
armdyn trial --hidden quadratic_drag=0.03 --out "$work/drag"
armdyn new pendulum "$work/model.toml" --set mass="80 g +/- 0.8 g"
armdyn repair "$work/model.toml" "$work/drag/trial.csv" --output "$work/repaired.toml" --report "$work/repair.html"
shoot "$work/repair.html" "$PWD/docs/pictures/repair_report.png" 1500
