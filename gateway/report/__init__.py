"""The report of a run: a table for the terminal and one self-contained HTML page."""

from gateway.report.data import SHIFTS, TRUTH_WIDTH, AdoptedModels, CycleSeen, NotYet, ReportData, Truth
from gateway.report.figures import Summary, SummaryRow, summary, table
from gateway.report.first_lines import by_shift, losses, verdict
from gateway.report.page import build, nothing_learnt
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
    "losses",
    "nothing_learnt",
    "picture",
    "summary",
    "table",
    "verdict",
]
