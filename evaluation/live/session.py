"""A session in the laboratory: what the operator may order, and what the screen shows."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation.calibration import calibrate
from evaluation.live.acquisition import Acquisition, Answer, Begin, End, Note
from evaluation.live.analysis import LiveAnalysis
from evaluation.live.peaks import Peak
from evaluation.live.settings import LabSettings
from evaluation.live.takes import STANDING, StudyFile, Take, finish_take, log_name
from evaluation.live.zeroing import empty_plate
from evaluation.record.recorder import Written
from evaluation.sources.stream import LabError, PlateInfo, Source
from hilbrace.errors import HilbraceError, InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.recording import read_recording

STANDING_S = 2.0
"""Length of a standing trial [s]."""

ZERO_S = 1.5
"""How long empty plates are looked at [s]."""

LATEST_S = 15.0
"""Longest wait for the frames of a standing trial [s]."""


@dataclass(frozen=True)
class TallyRow:
    """What was measured in one condition so far.

    Attributes:
        condition: Its name.
        takes: Finished takes, those of an earlier session too.
        bending: Mean bending peak of this session's takes; ``None`` before the first.
        landing: Mean landing peak.
    """

    condition: str
    takes: int
    bending: Peak | None
    landing: Peak | None


class LabSession:
    """Devices, recorder and analysis under one roof; every method may be called from any thread.

    Args:
        settings: What is measured.
        folder: Where recordings go; it is made if absent.
        sources: The devices.

    Raises:
        InputError: The folder cannot be made, or two devices have one name.
        ConfigError: The folder holds a study that cannot be continued.
    """

    def __init__(self, settings: LabSettings, folder: Path, sources: Sequence[Source]) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise InputError(
                f"cannot make the folder: {fault.strerror}", where=str(folder), hint="give another --out"
            ) from None
        self.settings, self.folder = settings, folder
        self.study = StudyFile(folder, settings)
        self.acquisition = Acquisition(sources, analyse=True)
        markers = settings.protocol.markers
        self.analysis = LiveAnalysis(self.acquisition.analysis, (*markers.thigh, *markers.shank))
        self._order = threading.Lock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="session")
        self._condition = settings.names[0]
        self._recording_of: str | None = None
        self._begun_s = 0.0
        self._peaks: dict[str, list[tuple[Peak | None, Peak | None]]] = {name: [] for name in settings.names}
        self._zeros: dict[tuple[str, str], list[float]] = {}
        self._busy = ""
        self.takes: list[Take] = []
        self.fault = ""

    def start(self) -> None:
        """Begin to read the devices; a standing trial on the disk calibrates at once.

        Raises:
            InputError: The standing trial cannot be used.
        """
        self._calibrate_from_file()
        self.analysis.start()
        self.acquisition.start()

    def stop(self) -> None:
        """Finish the take, if there is one, and let the devices go."""
        with self._order:
            recording = self._recording_of is not None
        if recording:
            try:
                self.end_take()
            except HilbraceError as fault:
                self._recording_of, self.fault = None, fault.two_lines()
        self._worker.shutdown()
        self.acquisition.stop()
        self.analysis.stop()

    @property
    def condition(self) -> str:
        """The brace condition that counts now."""
        return self._condition

    @property
    def recording_of(self) -> str | None:
        """Condition of the take under way; ``None`` without one."""
        return self._recording_of

    @property
    def seconds(self) -> float:
        """Since the take under way, or the last one, began [s]."""
        return time.monotonic() - self._begun_s

    @property
    def busy(self) -> str:
        """What is under way and takes a moment; empty if nothing is."""
        return self._busy

    def choose_condition(self, name: str) -> str:
        """Make a brace condition the one that counts; during a take, for the whole take.

        Args:
            name: One of the settings' conditions.

        Returns:
            What happened, in a sentence.

        Raises:
            InputError: There is no such condition.
        """
        if name not in self.settings.names:
            raise InputError(
                f"'{name}' is no condition",
                where="condition",
                hint=f"choose {', '.join(self.settings.names)}",
            )
        with self._order:
            self._condition = name
            if self._recording_of not in (None, STANDING):
                self._note("condition", name, {})
                return f"{name}: marked in the recording"
        return f"{name} is next"

    def begin_take(self) -> str:
        """Start to record a take of the condition that counts.

        Returns:
            What happened, in a sentence.

        Raises:
            InputError: A take is running, or the file cannot be created.
        """
        with self._order:
            self._refuse_if_busy()
            path = self._begin(self._condition)
        return f"Recording {path.name}"

    def end_take(self) -> str:
        """Finish the take: close its file, convert it, count it.

        Returns:
            What happened, in a sentence.

        Raises:
            HilbraceError: There is no take, or its file could not be finished or converted.
        """
        with self._order:
            condition = self._recording_of
            if condition is None or condition == STANDING:
                raise InputError("no take is running", where="stop", hint="start one first")
            readings = self.analysis.readings()
            take = self._finish(condition)
            self._peaks[take.condition].append((readings.bending, readings.landing))
            self.takes.append(take)
        lost = f" {take.notes[0]}" if take.notes else ""
        return f"{take.c3d.name} is written ({take.condition}).{lost}"

    def record_standing(self) -> "Future[str]":
        """Record two seconds of standing, and calibrate with them; the result follows when it is there.

        Raises:
            InputError: A take is running.
            LabError: No device sends markers.
        """
        with self._order:
            self._refuse_if_busy()
            leg = self.analysis.marker_source()
            if leg is None or not leg.rate_hz > 0:
                raise LabError(
                    "no device sends markers", where="standing", hint="connect the marker system first"
                )
            self._begin(STANDING)
            self._busy = "standing trial"
            until = self.analysis.frames + round(STANDING_S * leg.rate_hz)
        return self._worker.submit(self._stand, until)

    def zero_plates(self) -> "Future[str]":
        """Measure the empty plates, and subtract them from now on; the result follows when it is there.

        Raises:
            InputError: A standing trial or a zero is under way.
        """
        with self._order:
            self._refuse_if_busy(takes=False)
            self._busy = "zero"
        return self._worker.submit(self._measure_zero)

    def tally(self) -> tuple[TallyRow, ...]:
        """What was measured in each condition so far."""
        counts = self.study.counts
        return tuple(
            TallyRow(name, counts.get(name, 0), _mean([p[0] for p in peaks]), _mean([p[1] for p in peaks]))
            for name, peaks in list(self._peaks.items())
        )

    def _refuse_if_busy(self, takes: bool = True) -> None:
        if self._busy:
            raise InputError(f"a {self._busy} is under way", where="session", hint="wait until it is over")
        if takes and self._recording_of is not None:
            raise InputError("a take is running", where="session", hint="stop it first")

    def _begin(self, condition: str) -> Path:
        content = {
            "condition": condition,
            "study": self.settings.name,
            "subject": self.settings.subject,
            "protocol": self.settings.protocol.model_dump(mode="json"),
        }
        if self.settings.stomps:
            content["stomps"] = self.settings.stomps
        answer = Answer()
        path = log_name(self.folder, condition)
        self.acquisition.recorder.mailbox.order(Begin(path, content, answer))
        written = answer.wait()
        self._recording_of, self._begun_s = condition, time.monotonic()
        self.analysis.new_take()
        if condition != STANDING:
            self._note("condition", condition, {})
        for key in self._zeros:
            self._note_zero(key)
        return written.path

    def _note(self, kind: Any, text: str, content: dict[str, Any]) -> None:
        self.acquisition.recorder.mailbox.order(Note(kind, text, content))

    def _note_zero(self, key: tuple[str, str]) -> None:
        source, plate = key
        content = {"source": source, "plate": plate, "channels": self._zeros[key]}
        self._note("zero", f"{source} {plate}", content)

    def _end(self) -> Written:
        answer = Answer()
        self._recording_of = None
        self.acquisition.recorder.mailbox.order(End(answer))
        return answer.wait()

    def _finish(self, condition: str) -> Take:
        take = finish_take(self._end().path, condition)
        self.study.add(take)
        return take

    def _stand(self, until: int) -> str:
        """Wait until so many frames have come, and calibrate with the recording."""
        try:
            deadline = time.monotonic() + LATEST_S
            while self.analysis.frames < until and time.monotonic() < deadline:
                time.sleep(0.02)
            with self._order:
                take = finish_take(self._end().path, STANDING)
                self._calibrate(take.c3d)
                self.study.add(take)
            return "Standing trial recorded: angles are shown from now on"
        finally:
            self._busy = ""

    def _calibrate_from_file(self) -> None:
        if self.study.standing is not None:
            self._calibrate(self.study.standing)

    def _calibrate(self, path: Path) -> None:
        protocol = self.settings.protocol
        with C3DReader() as reader:
            standing = read_recording(path, None, protocol.vertical_axis, reader)
        self.analysis.calibrate(calibrate(standing, protocol, str(path)))

    def _measure_zero(self) -> str:
        try:
            plates = [(source, plate) for source, plate in self.analysis.plates() if not plate.zeroed]
            if not plates:
                return "The plates zero themselves: use the recording software, or the plate's own button"
            self.analysis.collect_plates()
            time.sleep(ZERO_S)
            kept = self.analysis.collected_plates()
            for source, plate in plates:
                self._accept_zero(source, plate, kept)
            return f"{len(plates)} plate{'s' if len(plates) > 1 else ''} zeroed"
        finally:
            self._busy = ""

    def _accept_zero(self, source: str, plate: PlateInfo, kept: dict[tuple[str, str], Any]) -> None:
        key = (source, plate.name)
        channels = empty_plate(plate, kept.get(key), self._zeros.get(key))
        with self._order:
            self._zeros[key] = channels.tolist()
            self.analysis.zero(source, plate.name, channels)
            if self._recording_of is not None:
                self._note_zero(key)


def _mean(peaks: Sequence[Peak | None]) -> Peak | None:
    known = [peak for peak in peaks if peak is not None]
    if not known:
        return None
    count = len(known)
    return Peak(
        sum(peak.time_s for peak in known) / count,
        sum(peak.flexion_deg for peak in known) / count,
        sum(peak.adduction_deg for peak in known) / count,
    )
