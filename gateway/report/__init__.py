"""The report of a run: a table for the terminal and one self-contained HTML page."""

from gateway.report.data import AdoptedModels, ReportData, Truth
from gateway.report.figures import Summary, SummaryRow, summary, table
from gateway.report.page import build
from gateway.report.plots import picture

__all__ = ["AdoptedModels", "ReportData", "Summary", "SummaryRow", "Truth", "build", "picture", "summary", "table"]
