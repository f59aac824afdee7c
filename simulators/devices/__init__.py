"""Emulated devices, faithful on the wire. Each takes physical values from a function and knows no plant."""
