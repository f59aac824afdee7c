"""Runs long computations in a separate process, so that the buses keep their periods.

The process runs at a lower priority than the gateway, in a control group of lower weight where there is one.
`python -m gateway.runtime.workers` is that process.
"""
