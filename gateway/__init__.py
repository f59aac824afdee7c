"""The service: configuration, acquisition, control loop, storage, telemetry and command line. It holds all policy.

It is a program: only the benchmarks use its rooms, by the names that each of them states. Beside the rooms stands
what several of them share (`apart`, `commands`, `events`, `passwords`, `versions`), and what the command line runs as a
whole (`service`, `metrics`); `client` is for programs of others.
"""

__all__: list[str] = []
