"""Emulated devices that behave like real ones on the wire. Each takes physical values from a function."""
