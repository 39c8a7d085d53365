"""A twin in a process of its own that obeys words on standard input and leaves a trace of everything; see `wire`."""

import sys
import threading
from pathlib import Path

import numpy as np

import ik
import urdf
from pipeline.ros.twin import SimulatedBaxterOnRos
from ros_wire.messages import TOPICS

uri, calibration, trace, seed = sys.argv[1:5]
hidden = {name: float(value) for name, value in (word.split("=") for word in sys.argv[5:])}
baxter = urdf.load("baxter")
posture = ik.default_table(baxter).posture(0.0).q
ended = threading.Event()

with SimulatedBaxterOnRos(uri, baxter, TOPICS, posture, hidden=hidden, seed=int(seed), stamp_offset=1234.5) as twin:
    twin.calibration.save(Path(calibration))
    print(f"loadcell {twin.port.port}\nREADY", flush=True)

    def obey():
        for word in sys.stdin:
            act = {"press": twin.controller.press, "unplug": twin.port.close}[word.strip()]
            twin._later(lambda _message, _now, act=act: act())({}, 0.0)  # between two steps of the plant
        ended.set()

    threading.Thread(target=obey, daemon=True).start()
    twin.run(ended.is_set)
    history, log = twin.robot.history(), twin.controller.log
    np.savez(
        trace,
        time=twin.start + history.time,
        q=history.q,
        received=np.array(log.received),
        positions=np.array(log.positions).reshape(-1, 7),
        behind=twin.behind,
        ignored=log.ignored,
        load_in_box=twin.robot.load_in_box(),
        length=twin.robot.truth.length,
    )
