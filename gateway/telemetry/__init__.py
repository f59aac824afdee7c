"""Telemetry: the messages that are published over Zenoh, and their keys.

`NcState`, `Source` and `Standing` are the texts of some fields, for programs that only read messages.
"""
