"""The page about serial plates and its reference sender say what the reader reads."""

import json
import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

from evaluation.plate_calibration import KEYS, UNITS
from evaluation.sources.ascii_lines import LineDecoder
from evaluation.sources.serial_frame import (
    Announcement,
    Edge,
    FrameDecoder,
    Sample,
    edge_frame,
    frame,
    read_announcement,
    sample_frame,
)

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "serial_plate.md").read_text("utf-8")
SKETCH = (DOCS / "serial_plate" / "serial_plate.ino").read_text("utf-8")

SENDER = r"""
#include <stdio.h>
#include "hilbrace_frame.h"
static uint8_t out[HILBRACE_INFO_SPACE];
int main(void) {
    static char line[1024];
    while (fgets(line, sizeof line, stdin)) {
        unsigned long sequence, microseconds; int channels, used; size_t size;
        if (line[0] == '#') {
            line[strcspn(line, "\n")] = 0;
            size = hilbrace_info(line + 1, out);
        } else if (line[0] == '!') {
            unsigned level;
            sscanf(line + 1, "%lu %u", &microseconds, &level);
            size = hilbrace_edge((uint32_t)microseconds, (uint8_t)level, out);
        } else {
            int32_t counts[HILBRACE_MOST_CHANNELS];
            char *at = line;
            sscanf(at, "%lu %lu %d%n", &sequence, &microseconds, &channels, &used);
            for (int k = 0; k < channels; k++) { at += used; sscanf(at, "%d%n", &counts[k], &used); }
            size = hilbrace_sample((uint16_t)sequence, (uint32_t)microseconds, counts, channels, out);
        }
        fwrite(out, 1, size, stdout);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def sender(tmp_path_factory):
    """The reference sender's frames, compiled as strictly as a compiler can."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    folder = tmp_path_factory.mktemp("sender")
    (folder / "sender.c").write_text(SENDER)
    flags = [
        "-std=c99",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wno-unused-function",
        "-Wno-unused-result",
    ]
    command = [compiler, *flags, "-Werror", "-I", str(DOCS / "serial_plate"), "sender.c", "-o", "sender"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)

    def send(lines: list[str]) -> bytes:
        text = "".join(f"{line}\n" for line in lines)
        return subprocess.run(
            [folder / "sender"], input=text.encode(), capture_output=True, check=True
        ).stdout

    return send


def test_the_reference_sender_writes_the_same_bytes_and_is_read(sender):
    rng = np.random.default_rng(4)
    lines, expected, said = [], b"", []
    for k in range(600):
        counts = rng.integers(-(2**31), 2**31, rng.integers(1, 33))
        counts[rng.random(len(counts)) < 0.3] = rng.choice([0, -1, 1, 256])
        sequence, clock = int(rng.integers(0, 65536)), int(rng.integers(0, 2**32))
        lines.append(" ".join(map(str, [sequence, clock, len(counts), *counts])))
        expected += sample_frame(sequence, clock, tuple(counts.tolist()))
        said.append(Sample(sequence, clock, tuple(counts.tolist())))
        if k % 50 == 0:
            lines.append(f"!{clock} {k % 100 // 50}")
            expected += edge_frame(clock, k % 100 // 50)
            said.append(Edge(clock, k % 100 // 50))
    wire = sender(lines)
    assert wire == expected
    assert FrameDecoder().feed(wire) == said


@pytest.mark.parametrize("size", [60, 240, 248, 249, 250, 251, 252, 260, 400])
def test_the_reference_sender_announces_at_every_length_where_stuffing_changes(sender, size):
    """A payload of 249 bytes and 4 of checksum without a zero fills one run of 254 with its type."""
    text = json.dumps({"rate_hz": 1000, "channels": ["f1"], "name": ""}, separators=(",", ":"))
    text = text[:-2] + "x" * (size - len(text)) + '"}'
    wire = sender(["#" + text])
    assert wire == frame(b"\x02" + text.encode())
    (told,) = FrameDecoder().feed(wire)
    assert isinstance(told, Announcement)
    assert told.channels == ("f1",)
    assert sender(["#" + "x" * 401]) == b""


def test_the_example_on_the_page_is_a_frame():
    example = re.search(r"^    (00 [0-9A-F ]+ 00)$", PAGE, re.MULTILINE)
    assert example is not None
    assert bytes.fromhex(example[1]) == sample_frame(1, 2000, (-1,))


def test_the_lines_on_the_page_are_lines():
    lines = re.findall(r"^    (.+\*[0-9A-F]{8})$", PAGE, re.MULTILINE)
    assert len(lines) == 2
    told, sample = LineDecoder().feed("".join(f"{line}\r\n" for line in lines).encode())
    assert isinstance(told, Announcement)
    assert sample == Sample(None, 1000123, (8312, -771, 90, 4411))


def test_what_the_page_and_the_sketch_announce_is_understood():
    on_page = re.search(r'^    (\{"name".+\})$', PAGE, re.MULTILINE)
    in_sketch = re.search(r'INFO\[\] =\s*"(.*)";', SKETCH)
    assert on_page is not None
    assert in_sketch is not None
    for text in (on_page[1], in_sketch[1].replace('\\"', '"')):
        told = read_announcement(text)
        assert told is not None
        assert (told.serial, told.rate_hz, len(told.channels)) == ("7", 1000.0, 4)


def test_the_page_names_every_key_of_a_calibration_file():
    assert all(re.search(rf"^    {key} =", PAGE, re.MULTILINE) for key in KEYS)
    assert all(f'"{units}"' in PAGE for units in UNITS)


def test_the_checksum_of_the_page_is_the_one_of_the_header():
    table = re.search(
        r"table\[16\] = \{(.*?)\}", (DOCS / "serial_plate/hilbrace_frame.h").read_text(), re.DOTALL
    )
    assert table is not None
    for k, word in enumerate(re.findall(r"0x[0-9a-f]{8}", table[1])):
        crc = k
        for _ in range(4):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
        assert int(word, 16) == crc
    assert struct.pack("<I", zlib.crc32(b"123456789")).hex() == "2639f4cb"
