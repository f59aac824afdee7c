"""Benchmarks beside peers: each module returns the rows of one subject; `python -m benchmarks` runs and tabulates them.

No other package uses anything of this one.
"""

__all__: list[str] = []
