"""The database of a gateway: writing while it runs, and reading."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.storage import columns
    from gateway.storage.answers import DiskWork, answered
    from gateway.storage.course_pages import StoredCourse, course_between
    from gateway.storage.damage import damage_found
    from gateway.storage.epochs import NUMBERS, Position
    from gateway.storage.faults import DamagedError, StoreError
    from gateway.storage.history import History, TimeSpan
    from gateway.storage.imported import import_learnt
    from gateway.storage.learnt import Learnt, Reference, learnt_text, parse_learnt
    from gateway.storage.mean_pages import means_page
    from gateway.storage.pages import ReadingsPage, readings_page
    from gateway.storage.readings import Retention
    from gateway.storage.row_pages import RowsPage, rows_after
    from gateway.storage.snapshot import Snapshot, SnapshotError, decode_snapshot, encode_snapshot, marks_of
    from gateway.storage.store import Store, boot_id
    from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredRun, StoredStep
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".answers": ("DiskWork", "answered"),
            ".columns": (),
            ".course_pages": ("StoredCourse", "course_between"),
            ".damage": ("damage_found",),
            ".epochs": ("NUMBERS", "Position"),
            ".faults": ("DamagedError", "StoreError"),
            ".history": ("History", "TimeSpan"),
            ".imported": ("import_learnt",),
            ".learnt": ("Learnt", "Reference", "learnt_text", "parse_learnt"),
            ".mean_pages": ("means_page",),
            ".pages": ("ReadingsPage", "readings_page"),
            ".readings": ("Retention",),
            ".row_pages": ("RowsPage", "rows_after"),
            ".snapshot": ("Snapshot", "SnapshotError", "decode_snapshot", "encode_snapshot", "marks_of"),
            ".store": ("Store", "boot_id"),
            ".stored": ("StoredCompensation", "StoredMeasurement", "StoredRun", "StoredStep"),
        },
    )

__all__ = [
    "NUMBERS",
    "DamagedError",
    "DiskWork",
    "History",
    "Learnt",
    "Position",
    "ReadingsPage",
    "Reference",
    "Retention",
    "RowsPage",
    "Snapshot",
    "SnapshotError",
    "Store",
    "StoreError",
    "StoredCompensation",
    "StoredCourse",
    "StoredMeasurement",
    "StoredRun",
    "StoredStep",
    "TimeSpan",
    "answered",
    "boot_id",
    "columns",
    "course_between",
    "damage_found",
    "decode_snapshot",
    "encode_snapshot",
    "import_learnt",
    "learnt_text",
    "marks_of",
    "means_page",
    "parse_learnt",
    "readings_page",
    "rows_after",
]
