"""Adds two kinds to talc-gateway: the control `text_axes`, which is only read, and the bus `text_tcp`."""
