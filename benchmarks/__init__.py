"""What is fast, and beside whom: one module a subject, each answers rows; `python -m benchmarks` runs and tabulates."""
