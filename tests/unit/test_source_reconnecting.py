"""Connections that break and come back, and losses by the device's own counter, with a device that obeys."""

from __future__ import annotations

import time

import numpy as np
import pytest

from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import LabError, MarkerFrame, PlateSamples, SourceEvent, SourceInfo

INFO = SourceInfo("cameras", "a device", ("A",), 200.0)


def frame(number):
    return MarkerFrame("cameras", number, number / 200, time.monotonic_ns(), np.zeros((1, 3)))


def samples(number, count=5, plate="left"):
    return PlateSamples("cameras", plate, number, 0.0, 1e-3, time.monotonic_ns(), np.zeros((count, 6)))


class Script:
    """A source that plays a list of blocks; an error in the list is raised instead."""

    name = "cameras"

    def __init__(self, *blocks, opens=()):
        self.blocks, self.opens = list(blocks), list(opens)
        self.opened, self.closed = [], 0

    def open(self):
        self.opened.append(time.monotonic())
        if self.opens and (fault := self.opens.pop(0)) is not None:
            raise fault
        return INFO

    def read(self, timeout_s):
        if not self.blocks:
            time.sleep(timeout_s)
            return []
        block = self.blocks.pop(0)
        if isinstance(block, LabError):
            raise block
        return block

    def close(self):
        self.closed += 1


def lost():
    return LabError("the cable is out", where="there", hint="plug it in")


def told(items):
    return [item.kind if isinstance(item, SourceEvent) else type(item).__name__ for item in items]


def test_the_first_connection_fails_as_the_device_does():
    with pytest.raises(LabError, match="cable"):
        Reconnecting(Script(opens=[lost()])).open()


def test_losses_stand_in_front_of_what_comes_after_them():
    source = Reconnecting(Script([frame(3), samples(15), frame(4), samples(20)], [frame(7), samples(40)]))
    assert source.open() == INFO
    assert told(source.read(0.0)) == ["connected"]
    assert told(source.read(0.0)) == ["MarkerFrame", "PlateSamples"] * 2
    items = source.read(0.0)
    assert told(items) == ["gap", "MarkerFrame", "gap", "PlateSamples"]
    assert (items[0].lost, items[0].plate, items[2].lost, items[2].plate) == (2, "", 15, "left")


def test_a_counter_that_starts_again_is_no_number_of_losses():
    source = Reconnecting(Script([frame(90), frame(0), frame(1)]))
    source.open()
    items = [item for _ in range(2) for item in source.read(0.0)]
    assert told(items) == ["connected", "MarkerFrame", "gap", "MarkerFrame", "MarkerFrame"]
    assert items[2].lost == 0
    assert "unknown" in items[2].text


def test_a_lost_connection_comes_back_with_growing_waits():
    script = Script([frame(0)], lost(), [frame(50)], opens=[None, lost(), lost(), None])
    source = Reconnecting(script, back_off_s=(0.05, 0.1))
    source.open()
    items = []
    while "gap" not in told(items):
        items += source.read(0.02)
    assert told(items) == [
        "connected",
        "MarkerFrame",
        "disconnected",
        "connected",
        "SourceInfo",
        "gap",
        "MarkerFrame",
    ]
    assert items[2].text == "the cable is out"
    assert items[5].lost == 49
    waits = np.diff(script.opened[1:])
    assert (waits >= 0.1).all()
    assert script.closed == 1


def test_silence_counts_as_a_broken_connection():
    source = Reconnecting(Script([frame(0)]), silence_s=0.1)
    source.open()
    end = time.monotonic() + 5
    items = []
    while "disconnected" not in told(items):
        assert time.monotonic() < end
        items += source.read(0.02)


def test_a_replay_that_ended_is_not_started_again():
    over = SourceEvent("cameras", "ended", 0, 1.0, "the file is over")
    script = Script([frame(0), over])
    source = Reconnecting(script, silence_s=0.0)
    source.open()
    assert told(source.read(0.0) + source.read(0.0)) == ["connected", "MarkerFrame", "ended"]
    assert source.read(0.01) == source.read(0.01) == []
    assert len(script.opened) == 1
