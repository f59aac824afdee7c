"""Reads every device of every bus once per period, checks the values, and reports problems."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.acquisition.acquisition import Acquisition
    from gateway.acquisition.board import Board
    from gateway.acquisition.build import lines_of
    from gateway.acquisition.line import Line
    from gateway.acquisition.once import read_once
    from gateway.acquisition.reload import BusChanges, PreparedReload, ReloadError, apply, bus_changes, prepare
    from gateway.acquisition.reports import channel_bad
    from gateway.acquisition.sample import Sample
    from gateway.acquisition.text import number_text, reading_text
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".acquisition": ("Acquisition",),
            ".board": ("Board",),
            ".build": ("lines_of",),
            ".line": ("Line",),
            ".once": ("read_once",),
            ".reload": ("BusChanges", "PreparedReload", "ReloadError", "apply", "bus_changes", "prepare"),
            ".reports": ("channel_bad",),
            ".sample": ("Sample",),
            ".text": ("number_text", "reading_text"),
        },
    )

__all__ = [
    "Acquisition",
    "Board",
    "BusChanges",
    "Line",
    "PreparedReload",
    "ReloadError",
    "Sample",
    "apply",
    "bus_changes",
    "channel_bad",
    "lines_of",
    "number_text",
    "prepare",
    "read_once",
    "reading_text",
]
