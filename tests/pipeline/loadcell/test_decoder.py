import random
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from pipeline.loadcell.faults import Fault
from pipeline.loadcell.protocol import Decoder, Reading, encode


def lines(numbers, counts=lambda number: 1000 + number):
    return [encode(Reading(number % 0x10000, counts(number))) for number in numbers]


def decode_all(pieces):
    decoder = Decoder()
    readings, faults = [], Counter()
    for piece in pieces:
        decoded = decoder.feed(piece)
        readings += decoded.readings
        faults += decoded.faults
    return readings, faults


@given(st.lists(st.sampled_from([*lines(range(6)), b"noise\n", b"# remark\r\n", b"HX711 3 ", b"\r\n"])), st.data())
def test_the_size_of_the_pieces_changes_nothing(parts, data):
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert decode_all(pieces) == decode_all([stream])


def test_both_line_ends_and_remarks_are_no_faults():
    stream = [b"# load cell with HX711\r\n", *(line[:-1] + b"\r\n" for line in lines(range(3))), b"\n", *lines([3, 4])]
    readings, faults = decode_all(stream)
    assert [reading.counts for reading in readings] == [1000, 1001, 1002, 1003, 1004]
    assert not faults


def test_a_torn_first_line_is_no_fault():
    readings, faults = decode_all([lines([7])[0][9:], *lines([8, 9])])
    assert [reading.sequence for reading in readings] == [8, 9]
    assert not faults


def test_a_whole_first_line_is_taken():
    assert decode_all(lines([7]))[0] == [Reading(7, 1007)]


def test_a_sample_behind_noise_on_its_line_is_taken_and_the_noise_counted():
    readings, faults = decode_all([*lines([0]), b"\xff\x00\xfeHX7 \x80", *lines([1, 2])])
    assert [reading.sequence for reading in readings] == [0, 1, 2]
    assert faults == {Fault.MALFORMED: 1}


def test_a_lost_line_feed_costs_one_sample_and_is_told():
    first, second, third, fourth = lines(range(4))
    readings, faults = decode_all([first, second[:-1], third, fourth])
    assert [reading.sequence for reading in readings] == [0, 2, 3]
    assert faults == {Fault.MALFORMED: 1, Fault.DROPPED: 1}


def test_lines_without_checksum_are_counted_and_dropped():
    readings, faults = decode_all([*lines([0]), b"HX711 1 1001\n", b"1001\n", b"HX711 1 1001 zzzz\n"])
    assert len(readings) == 1
    assert faults == {Fault.MALFORMED: 3}


def test_samples_come_again_after_any_noise():
    source = random.Random(4)
    for _ in range(200):
        noise = source.randbytes(source.randrange(2000))
        readings, faults = decode_all([*lines([0]), noise, b"\n", *lines([1, 2, 3])])
        assert [reading.sequence for reading in readings] == [0, 1, 2, 3]
        assert faults[Fault.MALFORMED] >= (1 if noise.strip(b"\r\n") else 0)
        assert set(faults) <= {Fault.MALFORMED}


def test_endless_noise_without_a_line_feed_is_one_fault_and_does_not_pile_up():
    decoder = Decoder()
    decoder.feed(lines([0])[0])
    for _ in range(1000):
        assert not decoder.feed(b"x" * 1000).readings
    assert len(decoder._rest) < 100
    decoded = decoder.feed(lines([1])[0])
    assert decoded.readings == [Reading(1, 1001)]
    assert decoded.faults == {Fault.MALFORMED: 1}


@given(st.lists(st.integers(1, 5), min_size=1, max_size=60), st.integers(0, 0xFFFF))
def test_every_sequence_number_left_out_is_one_dropped_sample(steps, first):
    numbers = [first]
    for step in steps:
        numbers.append(numbers[-1] + step)
    readings, faults = decode_all(lines(numbers))
    assert len(readings) == len(numbers)
    assert faults[Fault.DROPPED] == sum(steps) - len(steps)
    assert set(faults) <= {Fault.DROPPED}


def test_the_sequence_goes_from_65535_to_0_without_a_fault():
    readings, faults = decode_all(lines(range(65530, 65545)))
    assert len(readings) == 15
    assert not faults


def test_a_repeated_sample_is_taken_once():
    readings, faults = decode_all(lines([0, 1, 1, 1, 2]))
    assert [reading.sequence for reading in readings] == [0, 1, 2]
    assert faults == {Fault.REPEATED: 2}


def test_a_microcontroller_that_starts_anew_is_not_taken_for_lost_samples():
    readings, faults = decode_all(lines([500, 501, 0, 1]))
    assert len(readings) == 4
    assert faults == {Fault.RESTARTED: 1}
