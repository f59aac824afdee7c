"""Recordings: of machines (CSV, Parquet), read, checked and put on the grid; and of wires, as a text log."""
