"""The report of a run: a table for the terminal and one self-contained HTML page."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.report.data import TRUTH_WIDTH, WORK_SHIFTS, AdoptedModels, CycleSeen, NotYet, ReportData, Truth
    from gateway.report.figures import Summary, SummaryRow, summary, table
    from gateway.report.first_lines import verdict
    from gateway.report.local import local_moment
    from gateway.report.page import build, nothing_learnt, nothing_that_day
    from gateway.report.plots import picture
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".data": ("WORK_SHIFTS", "TRUTH_WIDTH", "AdoptedModels", "CycleSeen", "NotYet", "ReportData", "Truth"),
            ".figures": ("Summary", "SummaryRow", "summary", "table"),
            ".first_lines": ("verdict",),
            ".local": ("local_moment",),
            ".page": ("build", "nothing_learnt", "nothing_that_day"),
            ".plots": ("picture",),
        },
    )

__all__ = [
    "TRUTH_WIDTH",
    "WORK_SHIFTS",
    "AdoptedModels",
    "CycleSeen",
    "NotYet",
    "ReportData",
    "Summary",
    "SummaryRow",
    "Truth",
    "build",
    "local_moment",
    "nothing_learnt",
    "nothing_that_day",
    "picture",
    "summary",
    "table",
    "verdict",
]
