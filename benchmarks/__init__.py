"""Benchmarks beside peers: one module per subject returns rows; `python -m benchmarks` runs and tabulates them."""
