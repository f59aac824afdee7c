"""The service: configuration, acquisition, control loop, storage, telemetry and command line. It holds all policy.

It is a program. `client` is for programs of others (docs/client.md). Extensions use the names of `config`, `outlets`
and `telemetry` (docs/extensions.md), and the benchmarks those of all rooms. Beside the rooms stands what several of
them share (`commands`, `events`, `passwords`, `reading_blocks`, `versions`), and what the command line runs as a whole
(`service`, `metrics`).
"""

__all__ = ["client"]
