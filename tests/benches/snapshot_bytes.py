"""A snapshot as a store keeps it, without a store."""

import sqlite3
from contextlib import closing

from gateway.storage.snapshot import Snapshot, put_snapshots


def stored_bytes(snapshot: Snapshot) -> bytes:
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.execute("CREATE TABLE snapshot (state BLOB NOT NULL)")
        put_snapshots(connection, "INSERT INTO snapshot VALUES (zeroblob(?))", [(snapshot,)])
        return bytes(connection.execute("SELECT state FROM snapshot").fetchone()[0])
