"""Adds three kinds to talc-gateway.

They are the control `text_axes`, which is only read, the bus `text_tcp`, and the outlet `text_lines`.
"""
