"""Qualisys systems through the vendor's own client, ``qtm-rt`` (``pip install hilbrace[qualisys]``).

Every packet passes `evaluation.sources.qtm_gate` before the vendor's client sees it. Markers arrive in
millimetres. Forces and moments are read as the loads on the plate in the plate's axes, z down, moments about
the middle of its surface, as QTM displays them with the setting "Local (Force plate)".
"""

from __future__ import annotations

import asyncio
import importlib
import math
import socket
import struct
import time
from collections.abc import Callable, Coroutine
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from evaluation.sources.connection import connect
from evaluation.sources.qtm_gate import Gate
from evaluation.sources.qtm_settings import QtmPlate, QtmSettings, read_settings
from evaluation.sources.stream import Item, LabError, MarkerFrame, PlateSamples, SourceEvent, SourceInfo
from hilbrace.errors import InputError
from hilbrace.units import MM_PER_M

Array = np.ndarray
Answer = TypeVar("Answer")

PORT = 22223
PROTOCOL = "1.25"
CONNECT_S = 3.0
"""Longest wait for each answer of QTM, and for its first frame."""

_CHANGES = {"EventCameraSettingsChanged", "EventCaptureStarted", "EventRTfromFileStarted", "EventConnected"}
"""Events after which the settings may be others."""

_UNREADABLE = (struct.error, ValueError, IndexError, TypeError)


class QualisysSource:
    """QTM's real-time server as a source.

    Args:
        name: Name of the source.
        host: Address of the computer that runs QTM.
        port: Its port for little-endian clients.
        patience_s: Longest wait for an answer [s].
    """

    def __init__(self, name: str, host: str, port: int = PORT, patience_s: float = CONNECT_S) -> None:
        self._name, self._host, self._port, self._patience = name, host, port, patience_s
        self._runner: asyncio.Runner | None = None
        self._connection: Any = None
        self._refused: type[Exception] = LabError
        self._arrived = asyncio.Event()
        self._queue: list[tuple[Any, int]] = []
        self._lost: str | None = None
        self._settings = QtmSettings((), 0.0, "z", ())

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self._host}:{self._port}"

    def open(self) -> SourceInfo:
        """Connect, read the settings and start the stream.

        Raises:
            LabError: Nobody answers, something else than QTM answers, or no frame comes.
            InputError: ``qtm-rt`` is not installed, or the laboratory's vertical axis is not +y or +z.
        """
        vendor = _vendor()
        self.close()
        self._queue, self._lost, self._refused = [], None, vendor.QRTCommandException
        self._runner = asyncio.Runner()
        try:
            line = connect(self._host, self._port, self._patience, "QTM's real-time server")
            self._run(self._connect(vendor, line))
            info = self._run(self._describe())
            self._run(self._start())
        except (LabError, InputError):
            self.close()
            raise
        return info

    def read(self, timeout_s: float) -> list[Item]:
        """Frames and samples that have arrived.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: QTM closed the connection, or sends nonsense.
        """
        if self._runner is None:
            raise LabError("the source is not open", where=self.address, hint="call open first")
        self._run(self._wait(timeout_s))
        queue, self._queue = self._queue, []
        items: list[Item] = []
        try:
            for news, now in queue:
                items += self._items(news, now)
        except LabError as fault:
            self._lost = self._lost or fault.what
        if self._lost is not None and not items:
            raise LabError(
                f"the connection to QTM is lost: {self._lost}",
                where=self.address,
                hint="check that QTM still runs, and the cable",
            )
        return items

    def close(self) -> None:
        """Leave QTM."""
        if self._runner is None:
            return
        if self._connection is not None and self._connection.has_transport():
            self._connection.disconnect()
            self._runner.run(asyncio.sleep(0))
        self._runner.close()
        self._runner, self._connection = None, None

    def _run(self, work: Coroutine[Any, Any, Answer]) -> Answer:
        if self._runner is None:
            work.close()
            raise LabError("the source is not open", where=self.address, hint="call open first")
        return self._runner.run(work)

    async def _connect(self, vendor: ModuleType, line: socket.socket) -> None:
        self._arrived = asyncio.Event()
        loop = asyncio.get_running_loop()
        protocol = _gated(vendor, loop, self._on_news, self._on_loss)
        try:
            async with asyncio.timeout(self._patience):
                await loop.create_connection(lambda: protocol, sock=line)
                self._connection = vendor.QRTConnection(protocol, self._patience)
                await protocol.set_version(PROTOCOL)
        except TimeoutError as fault:
            if self._lost is not None:
                raise LabError(
                    f"the answer is not QTM's: {self._lost}",
                    where=self.address,
                    hint=f"check address and port (QTM's real-time server is on port {PORT})",
                ) from fault
            raise self._silent("does not answer") from fault
        except self._refused as fault:
            raise LabError(
                f"QTM refuses protocol {PROTOCOL}: {fault}",
                where=self.address,
                hint="update QTM to 2023.1 or later",
            ) from fault

    async def _describe(self) -> SourceInfo:
        """Ask for the settings."""
        try:
            text = await self._connection.get_parameters(["general", "3d", "force"])
        except TimeoutError as fault:
            raise self._silent("does not send its settings") from fault
        except self._refused as fault:
            raise self._silent(f"does not send its settings ({fault})") from fault
        self._settings = read_settings(text, self.address)
        return self._info()

    async def _start(self) -> None:
        components = ["3d", "force"] if self._settings.plates else ["3d"]
        try:
            await self._connection.stream_frames(components=components, on_packet=self._on_news)
        except (TimeoutError, self._refused) as fault:
            raise self._silent("sends no frames") from fault

    async def _wait(self, timeout_s: float) -> None:
        if self._queue or self._lost is not None:
            await asyncio.sleep(0)
            return
        self._arrived.clear()
        try:
            async with asyncio.timeout(timeout_s):
                await self._arrived.wait()
        except TimeoutError:
            return

    def _silent(self, what: str) -> LabError:
        return LabError(
            f"QTM {what} within {self._patience:g} s",
            where=self.address,
            hint="start a measurement or its preview in QTM (File > New), and check port and firewall",
        )

    def _on_news(self, news: Any) -> None:
        self._queue.append((news, time.monotonic_ns()))
        self._arrived.set()

    def _on_loss(self, fault: Exception | None) -> None:
        if self._lost is None:
            self._lost = fault.what if isinstance(fault, LabError) else str(fault or "it closed it")
        self._arrived.set()

    def _info(self) -> SourceInfo:
        settings = self._settings
        return SourceInfo(
            self._name,
            f"Qualisys Track Manager at {self.address}",
            settings.labels,
            settings.rate_hz,
            "y" if settings.up == "y" else "z",
            tuple(plate.info for plate in settings.plates),
            ("Forces are read in the plates' own axes: QTM's setting 'Local (Force plate)'.",)
            * bool(settings.plates),
        )

    def _items(self, news: Any, now: int) -> list[Item]:
        if not hasattr(news, "framenumber"):
            return self._event(news, now)
        try:
            return self._frame(news, now)
        except _UNREADABLE as fault:
            return [SourceEvent(self._name, "fault", now, math.nan, f"a packet was discarded: {fault}")]

    def _event(self, event: Any, now: int) -> list[Item]:
        kind = "trigger" if event.name == "EventTrigger" else "info"
        text = event.name.removeprefix("Event")
        news: Item = SourceEvent(self._name, kind, now, math.nan, f"QTM reports: {text}")
        return [news, *([self._run(self._describe())] if event.name in _CHANGES else [])]

    def _frame(self, packet: Any, now: int) -> list[Item]:
        items: list[Item] = []
        markers = packet.get_3d_markers()
        if markers is not None:
            positions = np.array(markers[1], float).reshape(-1, 3) / MM_PER_M
            if len(positions) != len(self._settings.labels):
                items.append(self._run(self._describe()))
            if len(positions) != len(self._settings.labels):
                raise ValueError(f"{len(positions)} markers for {len(self._settings.labels)} labels")
            time_s = 1e-6 * packet.timestamp
            items.append(MarkerFrame(self._name, packet.framenumber, time_s, now, positions))
        forces = packet.get_force()
        known = {plate.number: plate for plate in self._settings.plates}
        for plate, samples in forces[1] if forces is not None else ():
            if plate.id in known and samples:
                values = np.array(samples, float)[:, :6]
                items.append(self._samples(known[plate.id], plate.force_number, now, values))
        return items

    def _samples(
        self, plate: QtmPlate, number: int, now: int, values: Float[Array, "sample 6"]
    ) -> PlateSamples:
        period = 1.0 / plate.info.rate_hz
        return PlateSamples(self._name, plate.info.name, number, number * period, period, now, values)


def _vendor() -> ModuleType:
    try:
        return importlib.import_module("qtm_rt")
    except ImportError as fault:
        raise InputError(
            "the Qualisys client is not installed", where="qtm-rt", hint="pip install 'hilbrace[qualisys]'"
        ) from fault


def _gated(
    vendor: ModuleType,
    loop: asyncio.AbstractEventLoop,
    on_event: Callable[[Any], None],
    on_loss: Callable[[Exception | None], None],
) -> Any:
    """The vendor's protocol behind a `Gate`."""
    base: Any = importlib.import_module(f"{vendor.__name__}.protocol").QTMProtocol

    class Gated(base):
        """Passes on what the gate lets through."""

        def __init__(self) -> None:
            super().__init__(loop=loop, on_event=on_event, on_disconnect=on_loss)
            self.gate = Gate()

        def data_received(self, data: bytes) -> None:
            """Received from QTM."""
            try:
                packets = self.gate.feed(data)
            except LabError as fault:
                on_loss(fault)
                if self.transport is not None:
                    self.transport.abort()
                return
            for packet in packets:
                super().data_received(packet)

    return Gated()
