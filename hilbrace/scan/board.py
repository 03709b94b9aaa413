"""Boards for the calibration: ChArUco or chessboard, described, printed to size, found in pictures."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from hilbrace.errors import ConfigError
from hilbrace.run.records import write_atomic
from hilbrace.units import LENGTH_TO_M

Array = np.ndarray

MM_PER_INCH = 25.4
PRINT_PX_PER_MM = 12
DEFAULT_DICTIONARY = "4x4_50"
FORMS = (
    "charuco:7x5:30:22 (squares, square and marker in mm) or chessboard:9x6:25 (inner corners, square in mm)"
)

_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
_CHARUCO = re.compile(r"charuco:(\d+)x(\d+):([\d.]+):([\d.]+)(?::(\w+))?")
_CHESSBOARD = re.compile(r"chessboard:(\d+)x(\d+):([\d.]+)")


@dataclass(frozen=True)
class Board:
    """A flat calibration board.

    Attributes:
        kind: ``"charuco"`` or ``"chessboard"``.
        columns: Squares along a row; of a chessboard, inner corners along a row.
        rows: The same along a column.
        square_mm: Side of a square [mm].
        marker_mm: Side of a marker [mm]; 0 on a chessboard.
        dictionary: Markers, as OpenCV names them without ``DICT_``.
    """

    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = DEFAULT_DICTIONARY

    @property
    def text(self) -> str:
        """The word that describes it."""
        size = f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}"
        if self.kind == "chessboard":
            return size
        return f"{size}:{self.marker_mm:g}" + (
            "" if self.dictionary == DEFAULT_DICTIONARY else f":{self.dictionary}"
        )

    @property
    def squares(self) -> tuple[int, int]:
        """Squares along a row and along a column."""
        extra = 1 if self.kind == "chessboard" else 0
        return self.columns + extra, self.rows + extra

    @property
    def corner_count(self) -> int:
        """Inner corners."""
        across, down = self.squares
        return (across - 1) * (down - 1)

    def corner_places(self, numbers: Int[Array, " corner"]) -> Float[Array, "corner 3"]:
        """Places of inner corners on the board [mm], numbered row by row from the first."""
        across = self.squares[0] - 1
        flat = np.stack([numbers % across + 1, numbers // across + 1], axis=1) * self.square_mm
        return np.concatenate([flat, np.zeros((len(numbers), 1))], axis=1)


def parse_board(text: str) -> Board:
    """The board that a word describes.

    Raises:
        ConfigError: The word has another form, or there is no such board.
    """
    charuco, chessboard = _CHARUCO.fullmatch(text.strip()), _CHESSBOARD.fullmatch(text.strip())
    found = charuco or chessboard
    if not found:
        raise ConfigError(f"'{text}' describes no board", where="--board", hint=f"write {FORMS}")
    try:
        lengths = [float(length) for length in found.groups()[2:4] if length]
    except ValueError:
        lengths = [0.0]
    if charuco:
        board = Board(
            "charuco", int(found[1]), int(found[2]), lengths[0], lengths[-1], found[5] or DEFAULT_DICTIONARY
        )
    else:
        board = Board("chessboard", int(found[1]), int(found[2]), lengths[0])
    _check(board, text)
    return board


def find_corners(
    board: Board, picture: UInt8[Array, "row column"]
) -> tuple[Int[Array, " corner"], Float[Array, "corner 2"]]:
    """Inner corners of a board in a picture.

    Returns:
        Their numbers on the board, and their pixels; none where the board is not found.
    """
    return (
        _chessboard_corners(board, picture)
        if board.kind == "chessboard"
        else _charuco_corners(board, picture)
    )


def board_picture(board: Board, px_per_mm: int) -> UInt8[Array, "row column"]:
    """The board as it is printed, without margin."""
    across, down = board.squares
    size = round(across * board.square_mm * px_per_mm), round(down * board.square_mm * px_per_mm)
    if board.kind == "charuco":
        return np.asarray(_charuco(board).generateImage(size, marginSize=0), dtype=np.uint8)
    y, x = (np.floor((np.arange(n) + 0.5) / (board.square_mm * px_per_mm)) for n in size[::-1])
    return np.where((x[None, :] + y[:, None]) % 2 == 0, 0, 255).astype(np.uint8)


def write_board(board: Board, folder: Path) -> list[str]:
    """Write the board as a page to print at its true size.

    Returns:
        Name of the file.
    """
    from matplotlib.figure import Figure

    picture = board_picture(board, PRINT_PX_PER_MM)
    width, height = (side * board.square_mm for side in board.squares)
    margin = max(12.0, 0.5 * board.square_mm)
    page = (width + 2 * margin, height + 2 * margin)
    figure = Figure(figsize=(page[0] / MM_PER_INCH, page[1] / MM_PER_INCH))
    axes = figure.add_axes((margin / page[0], margin / page[1], width / page[0], height / page[1]))
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    note = f"hilbrace {board.text}: print at 100 %; a square must measure {board.square_mm:g} mm"
    figure.text(0.5, 0.3 * margin / page[1], note, ha="center", va="center", fontsize=7, color="0.4")
    stream = io.BytesIO()
    figure.savefig(stream, format="pdf", metadata={"CreationDate": None})
    write_atomic(folder / "board.pdf", stream.getvalue())
    return ["board.pdf"]


def _check(board: Board, text: str) -> None:
    longest = 2.0 / LENGTH_TO_M["mm"]
    wrong = ""
    if min(board.squares) < 3 or max(board.squares) > 60:
        wrong = f"a board of {board.squares[0]} x {board.squares[1]} squares"
    elif not 1.0 <= board.square_mm <= longest:
        wrong = f"squares of {board.square_mm:g} mm"
    elif board.kind == "charuco" and not 0.3 * board.square_mm <= board.marker_mm < board.square_mm:
        wrong = f"markers of {board.marker_mm:g} mm in squares of {board.square_mm:g} mm"
    elif board.kind == "charuco" and not hasattr(cv2.aruco, f"DICT_{board.dictionary.upper()}"):
        wrong = f"unknown markers '{board.dictionary}'"
    elif board.kind == "charuco" and board.columns * board.rows // 2 > len(_dictionary(board).bytesList):
        wrong = f"more markers than the {board.dictionary} has"
    if wrong:
        raise ConfigError(wrong, where=f"--board {text}", hint=f"write {FORMS}")


def _dictionary(board: Board) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary.upper()}"))


def _charuco(board: Board) -> cv2.aruco.CharucoBoard:
    return cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_mm, board.marker_mm, _dictionary(board)
    )


def _charuco_corners(
    board: Board, picture: UInt8[Array, "row column"]
) -> tuple[Int[Array, " corner"], Float[Array, "corner 2"]]:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    best: tuple[Array, Array] = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    for legacy in (False, True):
        # Boards printed by OpenCV before 4.6 begin with another colour where the rows are even.
        layout = _charuco(board)
        layout.setLegacyPattern(legacy)
        detector = cv2.aruco.CharucoDetector(layout, detectorParams=settings)
        corners, numbers, _, _ = detector.detectBoard(picture)
        if numbers is not None and len(numbers) > len(best[0]):
            best = (
                np.asarray(numbers, dtype=np.int64).ravel(),
                np.asarray(corners, dtype=float).reshape(-1, 2),
            )
        if len(best[0]) > board.corner_count / 2:
            break
    return best


def _chessboard_corners(
    board: Board, picture: UInt8[Array, "row column"]
) -> tuple[Int[Array, " corner"], Float[Array, "corner 2"]]:
    flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    found, corners = cv2.findChessboardCornersSB(picture, (board.columns, board.rows), flags=flags)
    if not found or corners is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    spacing = np.linalg.norm(np.diff(corners.reshape(board.rows, board.columns, 2), axis=1), axis=2).min()
    half = int(np.clip(0.3 * spacing, 2, 15))
    # The detector's own places lean by a tenth of a pixel on tilted boards.
    refined = cv2.cornerSubPix(picture, corners.astype(np.float32), (half, half), (-1, -1), _STOP)
    return np.arange(board.corner_count), np.asarray(refined, dtype=float).reshape(-1, 2)
