"""Micro-Epsilon displacement sensors on RS-485, and controllers on Ethernet."""
