"""A controller's state as bytes: versioned, with a checksum, without pickle.

SHA-256 of the rest (32 bytes), the format's name, the header's length (8 bytes, little-endian), the header as JSON, and
the arrays one after the other. Of an array of numbers a bit map says which of them are not zero, and only those follow:
a third of a learner's are zero.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from talc.control import ControllerState
from talc.frame import Frames, Why
from talc.snapshot import from_plain, to_plain

_NAME = b"talc-gateway snapshot 1\n"
_CHECKSUM = hashlib.sha256().digest_size
_LENGTH = 8
ARRAY_KINDS = {"f": "<f8", "i": "<i8", "b": "|b1"}
"""How arrays are stored, by the kind of their numbers."""
_SPARSE = "<f8"
_AT_ONCE = 65_536
"""Numbers that are packed at once; a multiple of 8."""


class SnapshotError(Exception):
    """It cannot be used; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What a run knew after a step, all that a restart needs besides the frames."""

    marks: str
    """Fingerprint of the settings and of the code that made it; others decide otherwise."""
    state: ControllerState
    measure: Why | None
    """The measurement that was wanted."""
    missing: Mapping[str, int]
    """Inputs without a good value, and the grid index since when."""
    measured: tuple[int | None, ...]
    """Grid index of each error's last measurement."""

    @property
    def k(self) -> int:
        """Grid index of its last step."""
        return -1 if self.state.last_k is None else self.state.last_k


def put_snapshots(connection: sqlite3.Connection, statement: str, rows: Iterable[Sequence[object]]) -> None:
    """Store each piece by piece: it is megabytes, and SQLite would hold several copies of them.

    Parameters
    ----------
    statement: inserts a row with a `state` of zeros, whose size is its last value
    rows: the values before that one, and the Snapshot
    """
    for row in rows:
        _put(connection, statement, row)


def _put(connection: sqlite3.Connection, statement: str, row: Sequence[object]) -> None:
    *before, snapshot = row
    if not isinstance(snapshot, Snapshot):
        raise TypeError(f"{snapshot!r}: expected a snapshot")
    size, pieces = _encoded(snapshot)
    number = connection.execute(statement, (*before, _CHECKSUM + size)).lastrowid
    if number is None:
        raise RuntimeError(f"stores no snapshot: {statement}")
    checksum = hashlib.sha256()
    with connection.blobopen("snapshot", "state", number) as state:
        state.seek(_CHECKSUM)
        for piece in pieces:
            checksum.update(piece)
            state.write(piece)
        state.seek(0)
        state.write(checksum.digest())


def _encoded(snapshot: Snapshot) -> tuple[int, Iterator[bytes]]:
    """How many bytes follow the checksum, and the bytes, piece by piece."""
    plain, arrays = to_plain(snapshot.state)
    header = {
        "marks": snapshot.marks,
        "measure": snapshot.measure,
        "missing": dict(snapshot.missing),
        "measured": snapshot.measured,
        "controller": plain,
        "arrays": [[name, ARRAY_KINDS[array.dtype.kind], array.shape] for name, array in arrays.items()],
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    begin = _NAME + len(text).to_bytes(_LENGTH, "little") + text
    ordered = [np.ascontiguousarray(array, dtype=ARRAY_KINDS[array.dtype.kind]) for array in arrays.values()]
    return len(begin) + sum(map(_packed_size, ordered)), chain([begin], *map(_packed, ordered))


def marks_of(data: bytes) -> str:
    """Fingerprint of the settings and code that made a snapshot. Raises SnapshotError: it is not whole."""
    marks = _header(data)[0]["marks"]
    return str(marks)


def decode_snapshot(data: bytes, frames: Callable[[int, int], Frames]) -> Snapshot:
    """The snapshot of which these are the bytes (`put_snapshots`).

    frames: gives those from a grid index to another one, both included

    Raises SnapshotError: it is not whole, or not of this program.
    """
    header, start = _header(data)
    try:
        arrays, rest = {}, memoryview(data)[start:]
        for name, kind, shape in header["arrays"]:
            arrays[name], rest = _unpacked(rest, kind, tuple(shape))
        return Snapshot(
            marks=header["marks"],
            state=from_plain(header["controller"], arrays, frames),
            measure=None if header["measure"] is None else Why(header["measure"]),
            missing=header["missing"],
            measured=tuple(header["measured"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise SnapshotError(f"not of this program: {error}") from error


def _header(data: bytes) -> tuple[Mapping[str, Any], int]:
    """The header, and where the arrays begin."""
    body = memoryview(data)[_CHECKSUM:]
    if hashlib.sha256(body).digest() != data[:_CHECKSUM]:
        raise SnapshotError("its checksum is wrong")
    if body[: len(_NAME)] != _NAME:
        raise SnapshotError(f"it does not begin with {bytes(_NAME)!r}")
    at = len(_NAME) + _LENGTH
    end = at + int.from_bytes(body[len(_NAME) : at], "little")
    return json.loads(bytes(body[at:end])), _CHECKSUM + end


def _packed(array: NDArray[Any]) -> Iterator[bytes]:
    if array.dtype != _SPARSE:
        yield array.tobytes()
        return
    bits = _bits(array)
    parts = [bits[begin : begin + _AT_ONCE] for begin in range(0, len(bits), _AT_ONCE)]
    for part in parts:
        yield np.packbits(part != 0).tobytes()
    for part in parts:
        yield part[part != 0].tobytes()


def _packed_size(array: NDArray[Any]) -> int:
    """How many bytes `_packed` gives."""
    return array.nbytes if array.dtype != _SPARSE else (array.size + 7) // 8 + 8 * int(np.count_nonzero(_bits(array)))


def _bits(array: NDArray[Any]) -> NDArray[np.uint64]:
    """The numbers' own bits: -0.0 is not zero here."""
    return array.reshape(-1).view("<u8")


def _unpacked(data: memoryview, kind: str, shape: tuple[int, ...]) -> tuple[NDArray[Any], memoryview]:
    """An array with its own memory, and what follows it."""
    dtype, size = np.dtype(kind), int(np.prod(shape))
    if kind != _SPARSE:
        end = size * dtype.itemsize
        return np.frombuffer(data[:end], dtype).reshape(shape).astype(dtype.newbyteorder("=")), data[end:]
    at = (size + 7) // 8
    map_, bits = np.frombuffer(data[:at], np.uint8), np.zeros(size, dtype="<u8")
    for begin in range(0, size, _AT_ONCE):  # what is zero is not written: untouched memory costs none
        part = bits[begin : begin + _AT_ONCE]
        there = np.unpackbits(map_[begin // 8 : (begin + _AT_ONCE) // 8], count=len(part)).astype(np.bool_)
        end = at + 8 * int(there.sum())
        if end > at:
            part[there] = np.frombuffer(data[at:end], "<u8")
        at = end
    return bits.view("<f8").reshape(shape).astype(np.float64, copy=False), data[at:]
