"""The SQLite store of one gateway."""
