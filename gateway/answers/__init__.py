"""Answers of a running gateway from its database: stored readings and decisions, courses, and reports of days."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.answers.day_reports import DayReports
    from gateway.answers.report_data import Reader, collect, empty_page, own_zone
    from gateway.answers.stored import course_of, history_of, rows_of
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".day_reports": ("DayReports",),
            ".report_data": ("Reader", "collect", "empty_page", "own_zone"),
            ".stored": ("course_of", "history_of", "rows_of"),
        },
    )

__all__ = ["DayReports", "Reader", "collect", "course_of", "empty_page", "history_of", "own_zone", "rows_of"]
