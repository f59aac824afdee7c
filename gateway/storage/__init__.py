"""The database of a gateway: what is written while it runs, and what is read of it."""

from gateway.storage.history import History
from gateway.storage.schema import StoreError
from gateway.storage.store import Store, boot_id
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredStep

__all__ = ["History", "Store", "StoreError", "StoredCompensation", "StoredMeasurement", "StoredStep", "boot_id"]
