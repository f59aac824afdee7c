"""The report of a run: a table for the terminal and one self-contained HTML page."""

from gateway.report.data import AdoptedModels, ReportData, Truth
from gateway.report.page import build
from gateway.report.summary import Row, Summary, summary, table

__all__ = ["AdoptedModels", "ReportData", "Row", "Summary", "Truth", "build", "summary", "table"]
