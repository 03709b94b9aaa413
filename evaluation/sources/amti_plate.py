"""An AMTI plate of the AccuSway+ and AccuGait class on a serial port."""

from __future__ import annotations

import contextlib
import math

import numpy as np

from evaluation.plate_calibration import Placement, PlateCalibration, plate_info
from evaluation.sources import amti
from evaluation.sources.amti import AmtiDecoder, AmtiSample
from evaluation.sources.arrival_model import ArrivalModel
from evaluation.sources.serial_port import SerialLine
from evaluation.sources.stream import Item, LabError, PlateSamples, SourceEvent, SourceInfo
from hilbrace.errors import InputError

ANSWER_S = 0.3
"""A command is answered within this time [s]."""

ZEROING_S = 12.0
"""The plate's own zeroing takes up to ten seconds [s]."""

UNVERIFIED = "AMTI's 12-channel RS-232 protocol as public programs speak it; not verified on hardware"


class AmtiPlate:
    """One AMTI plate as a source.

    It has no counter and no clock: samples are numbered from 0 as they arrive, time is their number times
    the period, and losses are seen in damaged bytes or estimated from the times of arrival, and say so.

    Attributes:
        received: Samples delivered since the source was made.
        damaged: Bytes passed over since then.
        lost: Samples that seem to be missing since then.
    """

    def __init__(
        self,
        name: str,
        port: str,
        calibration: PlateCalibration,
        placement: Placement | None = None,
        *,
        rate_hz: int = 200,
        auto_zero: bool = False,
    ) -> None:
        """A plate that is not yet connected.

        Args:
            name: Name of the source and of its plate.
            port: Serial port.
            calibration: What its counts mean.
            placement: Where it lies; at the laboratory's origin if not told.
            rate_hz: 50, 100 or 200 samples per second [Hz].
            auto_zero: Let the plate, which must be empty, bring its amplifiers to zero at the first `open`.
                Never again after that: the zero of a session must not change when a plug is pulled.

        Raises:
            InputError: The plate has no such rate.
        """
        if rate_hz not in amti.RATES_HZ:
            raise InputError(
                f"an AMTI plate has no rate of {rate_hz} Hz",
                where=f"plate '{name}'",
                hint="choose one of " + ", ".join(map(str, amti.RATES_HZ)) + " Hz",
            )
        self.received = 0
        self.damaged = 0
        self.lost = 0
        self._name = name
        self._port = port
        self._calibration = calibration
        self._placement = placement or Placement()
        self._rate = rate_hz
        self._auto_zero = auto_zero
        self._serial: str | None = None
        self._line: SerialLine | None = None
        self._decoder = AmtiDecoder()
        self._arrivals = ArrivalModel(1.0 / rate_hz)
        self._start_s = 0.0
        self._last_host_s = math.nan
        self._trigger = False
        self._fresh = False

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    def open(self) -> SourceInfo:
        """Open the port and start the plate.

        Raises:
            LabError: The port cannot be opened, or the plate does not answer.
            InputError: Another plate answers than before, or its calibration has not twelve columns.
        """
        self.close()
        info = plate_info(
            self._name, float(self._rate), amti.CHANNEL_NAMES, self._calibration, self._placement
        )
        line = SerialLine(self._port, amti.FIRST_BAUD)
        try:
            set_rate(line, self._rate)
            self._accept(serial_number(line))
            if self._auto_zero:
                zero_amplifiers(line)
                self._auto_zero = False
            start(line)
        except (LabError, InputError):
            line.close()
            raise
        self._line, self._decoder, self._fresh = line, AmtiDecoder(), True
        return SourceInfo(
            source=self._name,
            device=f"AMTI plate {self._serial or 'that does not tell its serial number'}",
            up=self._placement.up,
            plates=(info,),
            notes=(UNVERIFIED, "without a counter, losses are estimated from the times of arrival"),
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
        return self._line.collect(timeout_s, lambda data, now: self._items(self._decoder.feed(data), now))

    def close(self) -> None:
        """Stop the plate and give the port back."""
        if self._line is None:
            return
        line, self._line = self._line, None
        with contextlib.suppress(LabError):  # a dead line needs no stopping
            line.write(amti.STOP)
        line.close()

    def _accept(self, serial: str) -> None:
        if self._serial and serial and serial != self._serial:
            raise InputError(
                f"another plate answers: AMTI {serial}",
                where=f"{self._port}, which was AMTI {self._serial}",
                hint="put the plate back on its port; a new plate needs a new zero, so start again with it",
            )
        self._serial = serial or self._serial

    def _items(self, found: list[AmtiSample | amti.Skipped], now: int) -> list[Item]:
        items: list[Item] = []
        run: list[AmtiSample] = []
        for one in found:
            if isinstance(one, AmtiSample):
                items += self._resumed(now) if self._fresh else []
                items += self._trigger_edge(one, len(run), now)
                run.append(one)
            elif not self._fresh:
                items += self._samples(run, now)
                items.append(self._skipped(one.size, now))
        items += self._samples(run, now)
        return items

    def _resumed(self, now: int) -> list[Item]:
        """The first sample since the port was opened: the host's clock tells how many are missing."""
        self._fresh = False
        if math.isnan(self._last_host_s):
            return []
        away = 1e-9 * now - self._last_host_s
        lost = max(0, round(away * self._rate) - 1)
        self._start_s += (self._arrivals.place + lost) / self._rate
        self._arrivals = ArrivalModel(1.0 / self._rate)
        self.lost += lost
        return [
            self._gap(now, f"about {lost} samples are missing after {away:.2f} s without the plate", lost)
        ]

    def _skipped(self, size: int, now: int) -> SourceEvent:
        lost = math.ceil(size / amti.FRAME_BYTES)
        self.damaged += size
        self.lost += lost
        self._arrivals.skip(lost)
        return self._gap(now, f"{size} bytes without a sample were passed over, about {lost} samples", lost)

    def _trigger_edge(self, sample: AmtiSample, position: int, now: int) -> list[Item]:
        before, self._trigger = self._trigger, sample.trigger
        if before == sample.trigger:
            return []
        at = self._time(self._arrivals.place + position)
        text = f"trigger input {int(sample.trigger)}"
        return [SourceEvent(self._name, "trigger", now, at, text, plate=self._name)]

    def _samples(self, run: list[AmtiSample], now: int) -> list[Item]:
        """A run of consecutive samples as one item, after what its arrival tells; empties the run."""
        if not run:
            return []
        number, at = self.received, self._time(self._arrivals.place)
        seemingly = self._arrivals.arrive(len(run), 1e-9 * now)
        self.received += len(run)
        self._last_host_s = 1e-9 * now
        values = np.array([one.counts for one in run], float)
        run.clear()
        items: list[Item] = [PlateSamples(self._name, self._name, number, at, 1.0 / self._rate, now, values)]
        if seemingly:
            self.lost += seemingly
            text = f"about {seemingly} samples went missing in the last second, by the times of arrival"
            items.append(self._gap(now, text, seemingly))
        return items

    def _gap(self, now: int, text: str, lost: int) -> SourceEvent:
        at = self._time(self._arrivals.place)
        return SourceEvent(self._name, "gap", now, at, text, lost=lost, plate=self._name)

    def _time(self, place: int) -> float:
        """The plate's own time: its sample's place times the period [s]."""
        return self._start_s + place / self._rate


def set_rate(line: SerialLine, rate_hz: int) -> None:
    """Stop a plate, whatever it is doing at whatever speed, and set its rate.

    Args:
        line: An open port.
        rate_hz: One of `amti.RATES_HZ` [Hz].

    Raises:
        LabError: Nothing answers, or something else does.
    """
    rate = amti.RATES_HZ[rate_hz]
    heard = 0
    for baud in sorted({amti.FIRST_BAUD} | {rate.baud for rate in amti.RATES_HZ.values()}):
        line.set_baud(baud)
        line.write(amti.STOP)
        heard += line.drain(quiet_s=0.08)
        line.write(rate.command)
        answer = line.read_exactly(1, ANSWER_S)
        if answer == rate.command:
            line.set_baud(rate.baud)
            return
        heard += len(answer)
    if heard:
        raise LabError(
            f"something answers at this port, but no AMTI plate ({heard} bytes)",
            where=line.path,
            hint="check that the port is the plate's; USB adapters often fail at rates other than 50 Hz",
        )
    raise LabError(
        "the port is open but no plate answers",
        where=line.path,
        hint="check power and cable, and that the plate's switches A+B are set for the serial line",
    )


def serial_number(line: SerialLine) -> str:
    """Serial number of a stopped plate; empty for those that do not tell it.

    Args:
        line: A port whose plate is stopped.
    """
    line.write(amti.SERIAL_NUMBER)
    if line.read_exactly(1, ANSWER_S) != amti.SERIAL_FOLLOWS:
        line.drain()
        return ""
    return line.read_exactly(amti.SERIAL_BYTES, ANSWER_S).decode("ascii", "replace").strip()


def zero_amplifiers(line: SerialLine) -> None:
    """Let a stopped, empty plate bring its amplifiers to zero.

    Args:
        line: A port whose plate is stopped.

    Raises:
        LabError: The plate does not confirm.
    """
    line.write(amti.AUTO_ZERO)
    answer = line.read_exactly(1, ZEROING_S)
    if answer == amti.ZEROED and len(line.read_exactly(amti.ZEROED_BYTES, 1.0)) == amti.ZEROED_BYTES:
        return
    raise _refused(line, "zero its amplifiers", answer)


def start(line: SerialLine) -> None:
    """Let a stopped plate send samples.

    Args:
        line: A port whose plate is stopped.

    Raises:
        LabError: The plate does not confirm.
    """
    line.write(amti.START)
    answer = line.read_exactly(1, ANSWER_S)
    if answer != amti.STARTED:
        raise _refused(line, "start", answer)


def _refused(line: SerialLine, deed: str, answer: bytes) -> LabError:
    if answer in amti.TWO_PLATES:
        return LabError(
            "two plates share this line", where=line.path, hint="give each plate a serial port of its own"
        )
    return LabError(
        f"the plate did not {deed} (it said {answer.hex() or 'nothing'})",
        where=line.path,
        hint="switch the plate off and on, and try again",
    )
