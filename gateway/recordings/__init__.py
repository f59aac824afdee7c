"""Recordings: of machines (CSV, Parquet), read, checked and put on the grid; and of wires, as a text log."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.recordings.cells import TimeFormat, second_of
    from gateway.recordings.columns import COLUMN_UNITS, Columns
    from gateway.recordings.files import FileTable, is_database, open_table
    from gateway.recordings.grid import Recording, read_recording
    from gateway.recordings.problems import FileProblems, RecordingError
    from gateway.recordings.table import write_table
    from gateway.recordings.wire_log import (
        BusTap,
        WireEvent,
        WireLog,
        WireLogError,
        WireLogWriter,
        is_wire_log,
        read_wire_log,
    )
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".cells": ("TimeFormat", "second_of"),
            ".columns": ("COLUMN_UNITS", "Columns"),
            ".files": ("FileTable", "is_database", "open_table"),
            ".grid": ("Recording", "read_recording"),
            ".problems": ("FileProblems", "RecordingError"),
            ".table": ("write_table",),
            ".wire_log": (
                "BusTap",
                "WireEvent",
                "WireLog",
                "WireLogError",
                "WireLogWriter",
                "is_wire_log",
                "read_wire_log",
            ),
        },
    )

__all__ = [
    "COLUMN_UNITS",
    "BusTap",
    "Columns",
    "FileProblems",
    "FileTable",
    "Recording",
    "RecordingError",
    "TimeFormat",
    "WireEvent",
    "WireLog",
    "WireLogError",
    "WireLogWriter",
    "is_database",
    "is_wire_log",
    "open_table",
    "read_recording",
    "read_wire_log",
    "second_of",
    "write_table",
]
