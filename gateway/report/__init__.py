"""The report of a run: a table for the terminal and one self-contained HTML page."""

from gateway.report.data import AdoptedModels, ReportData, Truth
from gateway.report.figures import Row, Summary, summary, table
from gateway.report.page import build

__all__ = ["AdoptedModels", "ReportData", "Row", "Summary", "Truth", "build", "summary", "table"]
