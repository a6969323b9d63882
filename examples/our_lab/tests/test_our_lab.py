"""The package's actuator keeps the promises of an actuator, and its segment becomes faster."""

from model_of_board import Board
from our_lab.air_pump import AirPump
from our_lab.chirp import chirp

from firmware_link.conformance import broken_promises


def test_the_air_pump_meets_the_requirements_of_an_actuator() -> None:
    assert broken_promises(AirPump, Board) == []


def test_a_chirp_becomes_faster() -> None:
    assert [sine.frequency_Hz for sine in chirp(0, 10, 0.1, 0.4, 3)] == [0.1, 0.2, 0.4]
