"""A picture of the live page of a watch: `python docs/watch_pictures.py OUT`, with a simulated UR5 that is touched."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from browser import Browser
from watch_work import model, samples, work
from workbench_pictures import keep

from armdyn.watch.fault_free import statistics_of_recordings
from armdyn.watch.watch import Watch
from pipeline.watch.page import LivePage

CONTACT = np.array([2.0, 5.0, 1.0, 0.3, -0.8, 0.0])


def main(out: Path) -> None:
    """A contact of 5 N m, then a load of 0.3 kg."""
    arm = model()
    runs = [work(arm, seed) for seed in range(100, 106)]
    watch = Watch(arm, statistics_of_recordings(arm, [lambda run=run: samples(run) for run in runs]), 0.01)
    with LivePage(watch, None) as page, Browser(1100, 560, dark=False) as tab:
        recordings = [work(arm, 1, load=0.3, begin=20.0), work(arm, 4, 30.0, begin=18.0, until=20.0, outside=CONTACT)]
        for minute, recording in enumerate(recordings):
            for sample in samples(recording, later=61.0 * minute):
                page.take(watch.process_sample(*sample))
        tab.go(page.address)
        tab.wait("document.querySelectorAll('svg').length")
        keep(tab, out / "watch.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
