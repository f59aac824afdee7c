"""The report of a run: a table for the terminal and one self-contained HTML page."""

from gateway.report.data import SHIFTS, TRUTH_WIDTH, AdoptedModels, CycleSeen, NotYet, ReportData, Truth
from gateway.report.figures import Summary, SummaryRow, summary, table
from gateway.report.first_lines import by_shift, losses, verdict
from gateway.report.local import local_moment
from gateway.report.page import build, nothing_learnt, nothing_that_day
from gateway.report.plots import picture

__all__ = [
    "SHIFTS",
    "TRUTH_WIDTH",
    "AdoptedModels",
    "CycleSeen",
    "NotYet",
    "ReportData",
    "Summary",
    "SummaryRow",
    "Truth",
    "build",
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
