"""The service: configuration, acquisition, control loop, storage, telemetry and command line. It holds all policy.

It is a program: only the benchmarks use its rooms, by the names that each of them states.
"""

__all__: list[str] = []
