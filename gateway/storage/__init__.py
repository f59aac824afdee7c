"""The database of a gateway: writing while it runs, and reading."""

from gateway.storage.damage import findings
from gateway.storage.faults import DamagedError, StoreError
from gateway.storage.history import History
from gateway.storage.imported import import_learnt
from gateway.storage.learnt import Learnt, Reference, learnt_text, parse_learnt
from gateway.storage.pages import ReadingsPage, readings_page
from gateway.storage.readings import Retention
from gateway.storage.snapshot import Snapshot, SnapshotError, decode, encode, marks_of
from gateway.storage.store import Store, boot_id
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredStep

__all__ = [
    "DamagedError",
    "History",
    "Learnt",
    "ReadingsPage",
    "Reference",
    "Retention",
    "Snapshot",
    "SnapshotError",
    "Store",
    "StoreError",
    "StoredCompensation",
    "StoredMeasurement",
    "StoredStep",
    "boot_id",
    "decode",
    "encode",
    "findings",
    "import_learnt",
    "learnt_text",
    "marks_of",
    "parse_learnt",
    "readings_page",
]
