"""The lines of the simplest self-built plates: ``t_us,ch0,...,chN*CRC``, readable in any terminal.

::

    #{"name":"bench","serial":"7","rate_hz":80,"channels":["f1","f2","f3","f4"]}*C0CD27DD
    1000123,8312,-771,90,4411*DE6BB4DA

`CRC` is the CRC-32 (IEEE 802.3) of the characters before the asterisk, as eight hexadecimal digits. A line
without a counter cannot tell how many were lost: the reader counts by the device's clock and says so.
"""

from __future__ import annotations

import re
import zlib

from evaluation.sources.serial_frame import (
    LONGEST_FRAME,
    MOST_CHANNELS,
    Announcement,
    Damage,
    Message,
    Sample,
    announcement_json,
    read_announcement,
)

_LINE = re.compile(rb"(.*)\*([0-9A-Fa-f]{8})")
_SAMPLE = re.compile(rb"(\d{1,10})((?:,-?\d{1,10})+)")


def sample_line(microseconds: int, counts: tuple[int, ...]) -> bytes:
    """Line of one sample.

    Args:
        microseconds: The device's clock; wraps at 2^32 [us].
        counts: Raw value of every channel.
    """
    return _checked(",".join(map(str, (microseconds & 0xFFFFFFFF, *counts))))


def info_line(plate: Announcement) -> bytes:
    """Line in which a plate says what it is.

    Args:
        plate: What it says.
    """
    return _checked("#" + announcement_json(plate))


class LineDecoder:
    """Turns a stream of bytes, in pieces of any length, into messages.

    Attributes:
        channels: Number of counts in a sample; lines with another number are damage. 0 accepts any until
            the plate has announced itself.
    """

    def __init__(self, channels: int = 0) -> None:
        """A decoder that knows nothing yet.

        Args:
            channels: Number of counts in a sample, if known.
        """
        self.channels = channels
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """Messages that these bytes complete.

        Args:
            data: Bytes in the order of their arrival.
        """
        *lines, self._rest = re.split(rb"[\r\n]", self._rest + data)
        messages = [message for line in lines if line for message in self._messages(line)]
        if len(self._rest) > LONGEST_FRAME:
            messages.append(Damage(len(self._rest)))
            self._rest = b""
        return messages

    def _messages(self, line: bytes) -> list[Message]:
        """The line's content; where an end of line was lost, a whole line may stand behind a damaged one."""
        checked = _LINE.fullmatch(line) if len(line) <= LONGEST_FRAME else None
        if checked is None:
            return [Damage(len(line))]
        text, check = checked[1], int(checked[2], 16)
        start = next((k for k in _starts(text) if zlib.crc32(text[k:]) == check), None)
        message = None if start is None else self._content(text[start:])
        if message is None:
            return [Damage(len(line))]
        return [Damage(start), message] if start else [message]

    def _content(self, text: bytes) -> Message | None:
        if not text.startswith(b"#"):
            return self._sample(text)
        plate = read_announcement(text[1:].decode("utf-8", "replace"))
        self.channels = len(plate.channels) if plate else self.channels
        return plate

    def _sample(self, text: bytes) -> Sample | None:
        parts = _SAMPLE.fullmatch(text)
        if parts is None or int(parts[1]) > 0xFFFFFFFF:
            return None
        counts = tuple(int(c) for c in parts[2][1:].split(b","))
        if len(counts) > MOST_CHANNELS or self.channels not in (0, len(counts)):
            return None
        return Sample(None, int(parts[1]), counts)


def _starts(text: bytes) -> list[int]:
    """Where an undamaged line may begin, the usual place first."""
    return [k for k, byte in enumerate(text) if k == 0 or byte in b"#0123456789"]


def _checked(text: str) -> bytes:
    return b"%s*%08X\r\n" % (text.encode(), zlib.crc32(text.encode()))
