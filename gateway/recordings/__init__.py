"""Recordings: of machines (CSV, Parquet), read, checked and put on the grid; and of wires, as a text log."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.recordings.chunks import FileTable
    from gateway.recordings.columns import Columns
    from gateway.recordings.files import is_database, open_table
    from gateway.recordings.grid import Recording, read_recording
    from gateway.recordings.layout import TextLayout, Unknown, line_ranges
    from gateway.recordings.problems import FileProblems, RecordingError
    from gateway.recordings.table import write_table
    from gateway.recordings.times import TIME_UNITS, TimeFormat, forms_of, second_of
    from gateway.recordings.wire_log import (
        WireEvent,
        WireLogError,
        WireLogWriter,
        is_wire_log,
        read_wire_log,
    )
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".chunks": ("FileTable",),
            ".columns": ("Columns",),
            ".files": ("is_database", "open_table"),
            ".grid": ("Recording", "read_recording"),
            ".layout": ("TextLayout", "Unknown", "line_ranges"),
            ".problems": ("FileProblems", "RecordingError"),
            ".table": ("write_table",),
            ".times": ("TIME_UNITS", "TimeFormat", "forms_of", "second_of"),
            ".wire_log": (
                "WireEvent",
                "WireLogError",
                "WireLogWriter",
                "is_wire_log",
                "read_wire_log",
            ),
        },
    )

__all__ = [
    "TIME_UNITS",
    "Columns",
    "FileProblems",
    "FileTable",
    "Recording",
    "RecordingError",
    "TextLayout",
    "TimeFormat",
    "Unknown",
    "WireEvent",
    "WireLogError",
    "WireLogWriter",
    "forms_of",
    "is_database",
    "is_wire_log",
    "line_ranges",
    "open_table",
    "read_recording",
    "read_wire_log",
    "second_of",
    "write_table",
]
