"""The report of a run: a table for the terminal and one self-contained HTML page."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.report.coordinates import CoordinateRow, by_coordinate
    from gateway.report.data import TRUTH_WIDTH, WORK_SHIFTS, AdoptedModels, CycleSeen, NotYet, ReportData, Truth
    from gateway.report.figures import Summary, SummaryRow, summary, table
    from gateway.report.first_lines import by_shift, losses, verdict
    from gateway.report.local import local_moment
    from gateway.report.page import build, nothing_learnt, nothing_that_day
    from gateway.report.plots import picture
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".coordinates": ("CoordinateRow", "by_coordinate"),
            ".data": ("WORK_SHIFTS", "TRUTH_WIDTH", "AdoptedModels", "CycleSeen", "NotYet", "ReportData", "Truth"),
            ".figures": ("Summary", "SummaryRow", "summary", "table"),
            ".first_lines": ("by_shift", "losses", "verdict"),
            ".local": ("local_moment",),
            ".page": ("build", "nothing_learnt", "nothing_that_day"),
            ".plots": ("picture",),
        },
    )

__all__ = [
    "TRUTH_WIDTH",
    "WORK_SHIFTS",
    "AdoptedModels",
    "CoordinateRow",
    "CycleSeen",
    "NotYet",
    "ReportData",
    "Summary",
    "SummaryRow",
    "Truth",
    "build",
    "by_coordinate",
    "by_shift",
    "local_moment",
    "losses",
    "nothing_learnt",
    "nothing_that_day",
    "picture",
    "summary",
    "table",
    "verdict",
]
