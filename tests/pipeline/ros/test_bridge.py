"""The rosbridge client against a loopback server: no ROS is needed."""

import math
import socket
import threading

import pytest

from armdyn.errors import InputError
from pipeline.ros import bridge as bridge_module
from pipeline.ros.bridge import BridgeError, RosBridge

TOPIC, KIND = "/load", "std_msgs/Float64"


@pytest.fixture
def heard(loopback, bridge):
    """What arrives on the topic."""
    messages = []
    bridge.subscribe(TOPIC, KIND, lambda message, _now: messages.append(message["data"]), throttle=0.05)
    loopback.wait_subscribed(TOPIC)
    return messages


def test_what_is_published_arrives_in_order_to_the_last_bit(loopback, bridge, heard, until):
    # Only the newest message is asked for, and none is held back.
    assert (loopback.requests[0]["queue_length"], loopback.requests[0]["throttle_rate"]) == (1, 50)
    assert bridge._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    bridge.advertise(TOPIC, KIND)
    numbers = [*range(200), 0.1, -1e-300, 1 / 3, 1.7e308]
    for number in numbers:
        bridge.publish(TOPIC, {"data": number})
    until(lambda: len(heard) == len(numbers))
    assert heard == numbers
    bridge.close()
    bridge.close()
    assert not bridge._thread.is_alive()


def test_a_message_in_pieces_is_put_together(loopback, heard, until):
    (client,) = loopback._clients
    client.send(iter(['{"op": "publish", "topic":', ' "/load", ', '"msg": {"data": 1}}']))
    until(lambda: heard)
    assert heard == [1]


def test_one_thread_per_sender_never_mixes_messages(loopback, bridge):
    def send(number):
        for k in range(50):
            bridge.publish(TOPIC, {"data": [number, k] * 50})

    threads = [threading.Thread(target=send, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    loopback.wait_for(lambda: len(loopback.requests) == 200)
    for number in range(4):
        assert [m["data"][1] for m in loopback.published(TOPIC) if m["data"][0] == number] == list(range(50))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_not_a_number_never_leaves(loopback, bridge, value, complains):
    with complains(InputError):
        bridge.publish(TOPIC, {"data": [0.0, value]})
    bridge.publish(TOPIC, {"data": 1.0})
    loopback.wait_for(lambda: loopback.requests)
    assert loopback.published(TOPIC) == [{"data": 1.0}]


def test_after_a_lost_connection_nothing_is_sent_or_queued(loopback, bridge, until, complains):
    bridge.publish(TOPIC, {"data": 1.0})
    loopback.wait_for(lambda: loopback.requests)
    loopback.drop()
    until(lambda: bridge.failure)
    for _ in range(3):
        with complains(BridgeError):
            bridge.publish(TOPIC, {"data": 2.0})
    heard = []
    with RosBridge(loopback.uri, clock=lambda: 42.0) as again:
        again.subscribe(TOPIC, KIND, lambda message, now: heard.append((message["data"], now)))
        loopback.wait_subscribed(TOPIC)
        again.publish(TOPIC, {"data": 3.0})
        until(lambda: heard)
    assert heard == [(3.0, 42.0)]  # dated by the clock that was given
    assert loopback.published(TOPIC) == [{"data": 1.0}, {"data": 3.0}]


def test_a_bridge_that_takes_nothing_is_given_up(loopback, bridge, monkeypatch, complains):
    monkeypatch.setattr(bridge_module, "SEND_TIMEOUT_SECONDS", 0.02)
    loopback.stall()
    large = {"data": "x" * 500_000}  # after a few of them more than the buffers of both systems

    def insist():
        for _ in range(100):
            bridge.publish(TOPIC, large)

    with complains(BridgeError):
        insist()


def test_a_subscriber_that_fails_ends_the_connection(loopback, bridge, until):
    bridge.subscribe(TOPIC, KIND, lambda message, _now: message["missing"])
    loopback.wait_subscribed(TOPIC)
    loopback.publish(TOPIC, {"data": 1.0})
    until(lambda: bridge.failure)
    assert "KeyError: 'missing'" in bridge.failure


@pytest.mark.parametrize("text", ["not json", "[1", '{"op": "publish"}'])
def test_what_is_no_message_ends_the_connection(loopback, bridge, until, text):
    bridge.publish(TOPIC, {"data": 1.0})
    loopback.wait_for(lambda: loopback.requests)
    loopback.say(text)
    until(lambda: bridge.failure)


def test_a_service_answers_or_is_named_where_it_fails_or_is_silent(loopback, bridge, monkeypatch, complains):
    asked = []
    loopback.answers["/rosapi/get_time"] = lambda arguments: asked.append(arguments) or {"time": 1}
    bridge.call("/rosapi/get_time")
    assert asked == [{}]
    monkeypatch.setattr(bridge_module, "ROSBRIDGE_TIMEOUT_SECONDS", 0.5)
    loopback.answers["/broken"] = lambda _arguments: None
    for service in ("/broken", "/nobody"):
        with complains(InputError):
            bridge.call(service)


@pytest.mark.parametrize("uri", ["http://localhost:9090", "robot", "wss://localhost:9090", "ws://127.0.0.1:1"])
def test_an_address_that_cannot_be_used_is_explained(uri, complains):
    with complains(InputError):
        RosBridge(uri)


def test_something_else_behind_the_port_is_explained(complains):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            connection, _ = server.accept()
            connection.recv(1000)
            connection.sendall(b"220 mail.example.org ready\r\n\r\n")
            connection.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with complains(InputError):
            RosBridge(f"ws://127.0.0.1:{server.getsockname()[1]}")
        thread.join()
