"""Readings as compressed columns: how the store keeps them beside its rows, and how a long history is sent.

A column is an array of little-endian numbers, compressed by zlib. Python makes an object for each number of a row that
it takes from SQLite; a block of thousands of readings it hands on as it is.
"""

import zlib
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

READING_ROW: Final = np.dtype([("id", "i8"), ("channel", "i8"), ("time", "f8"), ("value", "f8"), ("quality", "i8")])
"""Value: infinite, where there is none; quality: its number. Arrays take half the time of lists of rows."""
ReadingRows = NDArray[np.void]

_LEVEL: Final = 1
"""Higher ones take twenty times as long, and save a fifth of the bytes."""
_TYPES: Final = ("<f8", "<u2", "<f8", "u1")


class DamagedBlock(ValueError):
    """A block whose columns cannot be unpacked; the message names the column."""


class ReadingBlock(NamedTuple):
    """Readings in their order, as compressed columns."""

    rows: int
    first_s: float
    """The earliest time, UTC, seconds since 1970."""
    last_s: float
    """The latest one."""
    time: bytes
    """float64: UTC, seconds since 1970."""
    channel: bytes
    """uint16."""
    value: bytes
    """float64; NaN: none."""
    quality: bytes
    """uint8."""


class BlockColumns(NamedTuple):
    """The same, each an array with a number for each reading."""

    time: NDArray[np.float64]
    channel: NDArray[np.uint16]
    value: NDArray[np.float64]
    """NaN: none."""
    quality: NDArray[np.uint8]


def pack(rows: ReadingRows) -> ReadingBlock:
    """Rows as a block; at least one."""
    value = np.where(np.isfinite(rows["value"]), rows["value"], np.nan)
    return pack_columns(BlockColumns(rows["time"], rows["channel"], value, rows["quality"]))


def pack_columns(columns: BlockColumns) -> ReadingBlock:
    """Columns of the same length as a block; at least one reading."""
    time, channel, value, quality = (
        zlib.compress(np.asarray(column, kind).tobytes(), _LEVEL) for column, kind in zip(columns, _TYPES, strict=True)
    )
    first_s, last_s = float(columns.time.min()), float(columns.time.max())
    return ReadingBlock(len(columns.time), first_s, last_s, time, channel, value, quality)


def unpack(block: ReadingBlock) -> BlockColumns:
    """The columns of a block. Raises DamagedBlock."""
    columns = (_column(block, name, kind) for name, kind in zip(BlockColumns._fields, _TYPES, strict=True))
    return BlockColumns(*columns)


def _column(block: ReadingBlock, name: str, kind: str) -> NDArray[Any]:
    bytes_wanted = block.rows * np.dtype(kind).itemsize
    try:
        inflate = zlib.decompressobj()
        data = inflate.decompress(getattr(block, name), max(1, bytes_wanted))  # never more than was promised
        if len(data) != bytes_wanted or inflate.decompress(inflate.unconsumed_tail) or not inflate.eof:
            raise DamagedBlock(f"block of readings: {name}: expected {block.rows} numbers")
    except zlib.error as error:
        raise DamagedBlock(f"block of readings: {name}: {error}") from error
    return np.frombuffer(data, kind)
