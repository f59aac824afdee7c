"""Drivers, which read one device or control each. They do not know TALC or the gateway, and never retry or schedule."""
