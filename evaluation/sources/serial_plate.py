"""A self-built force plate on a serial port, speaking frames or lines (docs/serial_plate.md)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from evaluation.plate_calibration import Placement, PlateCalibration, plate_info
from evaluation.sources.ascii_lines import LineDecoder
from evaluation.sources.sample_order import Placed, SampleOrder
from evaluation.sources.serial_frame import Announcement, Damage, Edge, FrameDecoder, Message, Sample
from evaluation.sources.serial_port import SerialLine
from evaluation.sources.stream import EventKind, Item, LabError, PlateSamples, SourceEvent, SourceInfo
from hilbrace.errors import InputError

Wire = Literal["frames", "lines"]
"""``frames``: COBS with CRC-32; ``lines``: comma-separated text with CRC-32."""

Decoder = FrameDecoder | LineDecoder

DECODERS: dict[Wire, Callable[[], Decoder]] = {"frames": FrameDecoder, "lines": LineDecoder}

ASK = b"?"
"""What asks a plate to announce itself."""

ASK_EVERY_S = 0.1
"""How often it is asked, as the answer may be damaged [s]."""

ANSWER_S = 2.0
"""A plate announces itself every second, and sooner when it is asked."""

FAULT_REPORT_S = 0.5
"""Damaged frames are reported together, at most this often [s]."""


class SerialPlate:
    """One self-built plate as a source.

    It gives raw counts: its zero is the reader's, so that it survives a pulled plug. Numbers and times go on
    over an interruption; where the plate has started anew meanwhile, the host's clock tells how far.

    Attributes:
        received: Samples delivered since the source was made.
        damaged: Damaged or unknown frames since then.
    """

    def __init__(
        self,
        name: str,
        port: str,
        calibration: PlateCalibration,
        placement: Placement | None = None,
        *,
        baud: int = 921600,
        wire: Wire = "frames",
    ) -> None:
        """A plate that is not yet connected.

        Args:
            name: Name of the source and of its plate.
            port: Serial port.
            calibration: What its counts mean.
            placement: Where it lies; at the laboratory's origin if not told.
            baud: Bits per second; without meaning for plates that are USB devices themselves.
            wire: How it speaks.
        """
        self.received = 0
        self.damaged = 0
        self._name = name
        self._port = port
        self._calibration = calibration
        self._placement = placement or Placement()
        self._baud = baud
        self._wire: Wire = wire
        self._line: SerialLine | None = None
        self._decoder: Decoder = DECODERS[wire]()
        self._plate: Announcement | None = None
        self._order = SampleOrder(1.0)
        self._fresh = False
        self._exchanged = False
        self._unreported = 0
        self._last_report = -math.inf

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    def open(self) -> SourceInfo:
        """Open the port and wait for the plate to announce itself.

        Raises:
            LabError: The port cannot be opened, nothing comes, or not in this protocol.
            InputError: Another plate answers than before, or one that does not fit its calibration.
        """
        self.close()
        line = SerialLine(self._port, self._baud)
        try:
            plate, self._decoder = await_announcement(line, self._wire, ANSWER_S)
            self._accept(plate)
        except (LabError, InputError):
            line.close()
            raise
        self._line, self._fresh, self._exchanged = line, True, False
        info = plate_info(self._name, plate.rate_hz, plate.channels, self._calibration, self._placement)
        return SourceInfo(
            source=self._name,
            device=f"{plate.name} {plate.serial}".strip(),
            up=self._placement.up,
            plates=(info,),
            notes=self._notes(plate),
        )

    def read(self, timeout_s: float) -> list[Item]:
        """Samples and events that arrive within a time.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The line went dead.
        """
        if self._line is None:
            raise LabError(
                "the plate is not open", where=self._name, hint="open the source before reading it"
            )
        if self._exchanged:
            raise LabError(
                "the plate says that it is another one now", where=self._port, hint="connect to it again"
            )
        return self._line.collect(timeout_s, lambda data, now: self._items(self._decoder.feed(data), now))

    def close(self) -> None:
        """Give the port back."""
        if self._line is not None:
            self._line.close()
        self._line = None

    def _accept(self, plate: Announcement) -> None:
        """Begin with a plate, or go on with the one that was there before."""
        if self._plate is None:
            self._plate, self._order = plate, SampleOrder(plate.rate_hz)
            return
        if plate != self._plate:
            raise InputError(
                f"another plate answers: '{plate.name}' {plate.serial}, {plate.rate_hz:g} Hz, "
                f"{len(plate.channels)} channels",
                where=f"{self._port}, which was '{self._plate.name}' {self._plate.serial}",
                hint="put the plate back on its port; a new plate needs a new zero, so start again with it",
            )
        self._order.reopen()

    def _items(self, messages: list[Message], now: int) -> list[Item]:
        items: list[Item] = []
        run: list[Placed] = []
        for message in messages:
            self._exchanged |= isinstance(message, Announcement) and message != self._plate
            if self._exchanged:
                break
            if isinstance(message, Sample):
                self._fresh = False
                items += self._sample(message, run, now)
            elif isinstance(message, Edge):
                items.append(
                    self._event("trigger", now, f"trigger input {message.level}", message.microseconds)
                )
            elif isinstance(message, Damage) and not self._fresh:
                self._unreported += message.size
                self.damaged += 1
        items += self._samples(run)
        return items + self._faults(now)

    def _sample(self, sample: Sample, run: list[Placed], now: int) -> list[Item]:
        """Add a sample to the run; a run that ends here, and the news of a restart."""
        restarts, implausible = self._order.restarts, self._order.implausible
        placed = self._order.place(sample, now)
        self.damaged += self._order.implausible - implausible
        items: list[Item] = []
        if self._order.restarts > restarts:
            items += self._samples(run)
            items.append(
                self._event(
                    "restarted", now, "the plate started anew; what is missing follows from the host's clock"
                )
            )
        for one in placed:
            if run and one.number != run[-1].number + 1:
                items += self._samples(run)
            run.append(one)
        return items

    def _samples(self, run: list[Placed]) -> list[PlateSamples]:
        """A run of consecutive samples as one item; empties the run."""
        if not run or self._plate is None:
            return []
        self.received += len(run)
        item = PlateSamples(
            source=self._name,
            plate=self._name,
            number=run[0].number,
            device_time_s=run[0].device_time_s,
            period_s=1.0 / self._plate.rate_hz,
            host_time_ns=run[-1].host_time_ns,
            values=np.array([one.counts for one in run], float),
        )
        run.clear()
        return [item]

    def _faults(self, now: int) -> list[Item]:
        if not self._unreported or 1e-9 * now - self._last_report < FAULT_REPORT_S:
            return []
        text = f"{self._unreported} damaged bytes were discarded, {self.damaged} frames since the start"
        self._unreported, self._last_report = 0, 1e-9 * now
        return [self._event("fault", now, text)]

    def _event(self, kind: EventKind, now: int, text: str, clock_us: int | None = None) -> SourceEvent:
        at = math.nan if clock_us is None else self._order.time_of(clock_us)
        return SourceEvent(self._name, kind, now, at, text, plate=self._name)

    def _notes(self, plate: Announcement) -> tuple[str, ...]:
        notes = []
        if self._wire == "lines":
            notes.append("lines carry no counter: losses follow from the plate's clock and its stated rate")
        if plate.rate_hz < 100:
            notes.append(
                f"{plate.rate_hz:g} Hz is too slow for landings, where 1000 Hz is usual (HX711: 10 or 80 Hz)"
            )
        if plate.calibration and plate.calibration != self._calibration.name:
            notes.append(
                f"the plate names calibration '{plate.calibration}', '{self._calibration.name}' is in use"
            )
        return tuple(notes)


def await_announcement(line: SerialLine, wire: Wire, seconds: float) -> tuple[Announcement, Decoder]:
    """What the plate at a port says about itself, and the decoder that has read so far.

    Args:
        line: An open port.
        wire: How the plate speaks.
        seconds: Longest wait [s].

    Raises:
        LabError: Nothing comes, or nothing in this protocol.
    """
    decoder, arrived, samples = DECODERS[wire](), 0, 0
    now = next_ask = time.monotonic()
    end = now + seconds
    while now < end:
        if now >= next_ask:
            line.write(ASK)
            next_ask = now + ASK_EVERY_S
        data = line.read(ASK_EVERY_S)
        now = time.monotonic()
        arrived += len(data)
        messages = decoder.feed(data)
        samples += sum(isinstance(message, Sample) for message in messages)
        for message in messages:
            if isinstance(message, Announcement):
                return message, decoder
    raise _no_announcement(line.path, wire, arrived, samples, seconds)


def _no_announcement(path: str, wire: Wire, arrived: int, samples: int, seconds: float) -> LabError:
    where = f"{path}, {seconds:g} s"
    if not arrived:
        return LabError(
            "the port is open but nothing arrives",
            where=where,
            hint="check the plate's power and cable, and that transmit and receive are not swapped",
        )
    if samples:
        return LabError(
            f"{samples} samples arrive, but the plate does not say what they are",
            where=where,
            hint="send the info frame once a second (docs/serial_plate.md)",
        )
    other = "lines" if wire == "frames" else "frames"
    return LabError(
        f"{arrived} bytes arrive, but none of them form {wire}",
        where=where,
        hint=f"check the baud rate on both sides, or whether the plate speaks '{other}'",
    )
