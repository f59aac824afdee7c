"""Benchmarks beside peers: one module per subject returns rows; `python -m benchmarks` runs and tabulates them.

Nothing is for others.
"""

__all__: list[str] = []
