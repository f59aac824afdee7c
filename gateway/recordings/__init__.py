"""Recordings of machines and of wires: read, checked, replayed."""
