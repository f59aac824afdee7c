"""The database of a gateway: writing while it runs, and reading."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.storage import columns
    from gateway.storage.answers import DiskWork, answered
    from gateway.storage.block_pages import BlocksPage, blocks_page
    from gateway.storage.course_pages import StoredReasons, course_between
    from gateway.storage.damage import damage_found
    from gateway.storage.epochs import BEFORE_ALL, NUMBERS, Position
    from gateway.storage.faults import DamagedError, StoreError
    from gateway.storage.history import History, TimeSpan
    from gateway.storage.imported import import_learnt
    from gateway.storage.learnt import Learnt, Reference, learnt_text, parse_learnt
    from gateway.storage.mean_pages import means_page
    from gateway.storage.pages import readings_page
    from gateway.storage.readings import QUALITIES, Retention
    from gateway.storage.row_pages import RowsPage, rows_after
    from gateway.storage.snapshot import Snapshot, SnapshotError, decode_snapshot, marks_of
    from gateway.storage.store import Store, boot_id
    from gateway.storage.stored import StoredMeasurement, StoredStep
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".answers": ("DiskWork", "answered"),
            ".block_pages": ("BlocksPage", "blocks_page"),
            ".columns": (),
            ".course_pages": ("StoredReasons", "course_between"),
            ".damage": ("damage_found",),
            ".epochs": ("BEFORE_ALL", "NUMBERS", "Position"),
            ".faults": ("DamagedError", "StoreError"),
            ".history": ("History", "TimeSpan"),
            ".imported": ("import_learnt",),
            ".learnt": ("Learnt", "Reference", "learnt_text", "parse_learnt"),
            ".mean_pages": ("means_page",),
            ".pages": ("readings_page",),
            ".readings": ("QUALITIES", "Retention"),
            ".row_pages": ("RowsPage", "rows_after"),
            ".snapshot": ("Snapshot", "SnapshotError", "decode_snapshot", "marks_of"),
            ".store": ("Store", "boot_id"),
            ".stored": ("StoredMeasurement", "StoredStep"),
        },
    )

__all__ = [
    "BEFORE_ALL",
    "NUMBERS",
    "QUALITIES",
    "BlocksPage",
    "DamagedError",
    "DiskWork",
    "History",
    "Learnt",
    "Position",
    "Reference",
    "Retention",
    "RowsPage",
    "Snapshot",
    "SnapshotError",
    "Store",
    "StoreError",
    "StoredMeasurement",
    "StoredReasons",
    "StoredStep",
    "TimeSpan",
    "answered",
    "blocks_page",
    "boot_id",
    "columns",
    "course_between",
    "damage_found",
    "decode_snapshot",
    "import_learnt",
    "learnt_text",
    "marks_of",
    "means_page",
    "parse_learnt",
    "readings_page",
    "rows_after",
]
