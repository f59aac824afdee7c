"""Probing: when to request a cycle from the control, and whether to use its result."""
