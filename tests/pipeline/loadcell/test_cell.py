import contextlib
import threading
import time

import numpy as np
import pytest
import serial
import serial.serialposix
from hypothesis import given
from hypothesis import strategies as st
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from armdyn.errors import InputError
from pipeline.loadcell.cell import MIN_SAMPLE_SPACING_SECONDS, LoadCell, ReceptionClock
from pipeline.loadcell.emulator import EmulatedPort
from pipeline.loadcell.faults import LoadCellFault
from pipeline.loadcell.protocol import MAXIMUM_COUNTS

from .cells import calibration

CALIBRATION = calibration()
NEVER = 1e6  # s: silence is of no interest
COUNTS = [2000 + 7 * (k % 11) for k in range(5000)]  # never the same twice in a row


class StoppedClock:
    """A clock that moves only when told, so that no test depends on how busy the machine is."""

    now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture
def wire():
    with EmulatedPort() as port:
        yield port


@pytest.fixture
def clock():
    return StoppedClock()


@pytest.fixture
def cell(wire, clock):
    with LoadCell(wire.port, CALIBRATION, clock=clock, silent_after=0.2) as cell:
        yield cell


def began(cell):
    return [event.fault for event in cell.take_events() if event.began]


def test_forces_arrive_in_order_with_the_time_of_their_reception(wire, clock, cell, until):
    received = []
    for k, counts in enumerate(COUNTS[:50]):
        clock.now = 50.0 + 0.01 * k
        assert wire.send(wire.next_line(counts), 10.0)
        until(lambda k=k: cell.status().samples == k + 1)
        received += cell.read()
    assert [sample.force for sample in received] == pytest.approx([1e-4 * (c - 1000) for c in COUNTS[:50]])
    assert [sample.time for sample in received] == pytest.approx([50.0 + 0.01 * k for k in range(50)])
    status = cell.status()
    assert status.rate == pytest.approx(100.0)
    assert status.reliable
    assert not any(status.counts.values())


def test_a_cell_at_100_hz_with_every_fault_reports_each_and_keeps_the_good_samples(wire, until):
    """One run on a real pseudo-terminal at 100 Hz; which samples must arrive is known to the last one."""
    counts, expected = iter(COUNTS), []

    def good(value=None):
        expected.append(next(counts) if value is None else value)
        return wire.next_line(expected[-1])

    def lost():
        return wire.next_line(next(counts))

    steps = {
        "good": lambda: [good()],
        "lost": lambda: [lost()][:0],
        "torn": lambda: [lost()[:11] + b"\n"],
        "repeated": lambda: [good()] * 2,
        "garbage": lambda: [b"\xff\x00\x81 HX711 12 \xfe\n"],
        "behind noise": lambda: [b"\x00\xf3\xff" + good()],
        "in two pieces": lambda: [(line := good())[:5], line[5:]],
        "at its end": lambda: [good(MAXIMUM_COUNTS)],
        "stuck": lambda: [good(3333)],
    }
    script = [*["good"] * 20, "lost", "lost", "good", "torn", "good", "repeated", "good", "garbage", "good"]
    script += ["behind noise", *["in two pieces"] * 5, "at its end", *["good"] * 5, *["stuck"] * 100, *["good"] * 40]
    with LoadCell(wire.port, CALIBRATION, silent_after=NEVER) as cell:
        begin, received = time.monotonic(), []
        for k, step in enumerate(script):
            time.sleep(max(0.0, begin + 0.01 * k - time.monotonic()))
            for piece in steps[step]():
                assert wire.send(piece, 10.0)
            received += cell.read()
        until(lambda: cell.status().samples == len(expected))
        assert cell.status().reliable
        assert cell.status().rate > 0
        wire.close()
        until(lambda: not cell.status().connected)
        received += cell.read()
        status, events = cell.status(), cell.take_events()
    assert [sample.force for sample in received] == pytest.approx([CALIBRATION.force(c) for c in expected])
    assert np.all(np.diff([sample.time for sample in received]) > 0)
    # Dropped are two, and the one whose line was torn.
    told = {"DISCONNECTED": 1, "SATURATED": 1, "FROZEN": 1, "MALFORMED": 3, "DROPPED": 3, "REPEATED": 1}
    assert {fault.name: count for fault, count in status.counts.items() if count} == told
    assert status.active == (LoadCellFault.DISCONNECTED,)
    assert not status.reliable
    lasting = (LoadCellFault.SATURATED, LoadCellFault.FROZEN, LoadCellFault.DISCONNECTED)
    seen = [(event.fault, event.began) for event in events if event.fault in lasting]
    assert seen == [(fault, began) for fault in lasting for began in (True, False)][:-1]


def test_silence_is_noticed_without_a_sample_and_ends_with_one(wire, clock, cell, until):
    wire.send(wire.next_line(2000), 10.0)
    until(lambda: cell.status().samples == 1)
    assert cell.status().reliable
    clock.now += 0.21
    assert cell.status().active == (LoadCellFault.SILENT,)
    assert cell.status().rate == 0.0
    assert cell.status().connected
    wire.send(wire.next_line(2001), 10.0)
    until(lambda: cell.status().reliable)
    assert began(cell) == [LoadCellFault.SILENT]


def test_a_board_that_restarts_when_opened_has_time_to_do_so(clock, cell):
    clock.now += 4.0
    assert cell.status().active == ()
    assert not cell.status().reliable
    clock.now += 2.0
    assert cell.status().active == (LoadCellFault.SILENT,)


def test_a_reader_that_does_not_read_loses_the_oldest_samples_and_is_told_once(wire, clock, until, monkeypatch):
    monkeypatch.setattr("pipeline.loadcell.cell.MAX_QUEUED_SAMPLES_OR_EVENTS", 10)
    with LoadCell(wire.port, CALIBRATION, clock=clock) as cell:
        for counts in COUNTS[:50]:
            assert wire.send(wire.next_line(counts), 10.0)
        until(lambda: cell.status().samples == 50)
        assert [s.force for s in cell.read()] == pytest.approx([CALIBRATION.force(c) for c in COUNTS[40:50]])
        assert cell.status().counts[LoadCellFault.OVERFLOW] == 40
        assert began(cell) == [LoadCellFault.OVERFLOW]


def test_a_flood_of_noise_does_not_pile_up(wire, cell, until):
    noise = bytes(range(1, 256)) * 4
    for _ in range(300):
        assert wire.send(noise, 10.0)
    assert wire.send(b"\n" + wire.next_line(2000), 10.0)
    until(lambda: cell.status().samples == 1)
    assert cell.status().counts[LoadCellFault.MALFORMED] > 100
    assert len(cell.take_events()) <= 1000


def test_closing_ends_the_thread_and_frees_the_port_also_when_the_cable_was_pulled(wire, until):
    before = threading.active_count()
    for _ in range(3):
        with LoadCell(wire.port, CALIBRATION) as cell:
            assert threading.active_count() == before + 1
        cell.close()
        assert threading.active_count() == before
    assert not cell.status().connected
    assert LoadCellFault.DISCONNECTED not in cell.status().active
    cell = LoadCell(wire.port, CALIBRATION)
    for counts in COUNTS[:5]:
        wire.send(wire.next_line(counts), 10.0)
    until(lambda: cell.status().samples == 5)
    wire.close()
    until(lambda: began(cell) == [LoadCellFault.DISCONNECTED])
    assert [len(cell.read()), len(cell.read())] == [5, 0]  # what came before can be read, once
    cell.close()
    assert threading.active_count() == before


PORTS = [
    ("in use", [], "another program has it open"),
    ("/dev/ttyNONE", ["ttyACM7", "ttyACM1"], r"^/dev/ttyNONE: there is no such port: choose one of .*ACM1, .*ACM7$"),
    ("/dev/ttyNONE", [], r"none is present.*'emulated'"),
    ("forbidden", [], r"permission denied: 'sudo usermod -aG \w+ \$USER', then log in again$"),
    ("a file", [], "is not a serial port"),
]


@pytest.mark.parametrize(("port", "others", "says"), PORTS)
def test_a_port_that_cannot_be_opened_says_why_and_what_to_do(wire, monkeypatch, tmp_path, port, others, says):
    def forbidden(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(f"/dev/{name}") for name in others])
    with contextlib.ExitStack() as stack:
        if port == "in use":
            stack.enter_context(LoadCell(wire.port, CALIBRATION))
        elif port == "forbidden":
            stack.enter_context(monkeypatch.context()).setattr(serial.serialposix.os, "open", forbidden)
        elif port == "a file":
            port = str(tmp_path / "file")
            (tmp_path / "file").write_text("HX711 0 0\n")
        stack.enter_context(pytest.raises(InputError, match=says))
        LoadCell(port if port.startswith("/") else wire.port, CALIBRATION)


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 20)), min_size=1))
def test_times_strictly_increase_and_are_not_in_the_future(pieces):
    times, now, stamps = ReceptionClock(), 100.0, []
    for pause, count in pieces:
        now += pause
        new = times.reception_times(now, count)
        assert len(new) == count
        stamps += new
        # Only a clock that stands still pushes them ahead, by a microsecond each.
        assert all(stamp <= now + len(stamps) * MIN_SAMPLE_SPACING_SECONDS for stamp in new)
    assert np.all(np.diff(stamps) > 0)


def test_a_sample_that_comes_alone_has_the_time_of_its_reception_and_counts_in_the_rate():
    times = ReceptionClock()
    assert times.rate == 0.0
    alone = [k / 80 for k in range(500)] + [500 / 80 + k / 10 for k in range(200)]
    rates = []
    for now in alone:
        assert times.reception_times(now, 1) == [now]
        rates.append(times.rate)
    assert (rates[499], rates[-1]) == pytest.approx((80.0, 10.0))


@pytest.mark.parametrize(("now", "came"), [(0.54, [0.50, 0.51, 0.52, 0.53, 0.54]), (5.0, [4.98, 4.99, 5.0])])
def test_samples_collected_by_an_adapter_are_dated_back_to_when_they_came_but_not_over_a_silence(now, came):
    times = ReceptionClock()
    for k in range(50):
        times.reception_times(0.01 * k, 1)
    np.testing.assert_allclose(times.reception_times(now, len(came)), came, atol=1e-9)
