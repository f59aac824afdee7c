"""The service: configuration, acquisition, control loop, storage, telemetry and command line. It contains all policy.

It is a program. `client` is for other programs (docs/keys.md). Extensions use the names of `config`, `outlets` and
`telemetry` (docs/own-profile.md), and the benchmarks use the names of all rooms. The modules beside the rooms are
shared by several of them (`commands`, `events`, `passwords`, `reading_blocks`, `versions`), or are run by the command
line as a whole (`service`, `metrics`).
"""

__all__ = ["client", "config", "outlets", "telemetry"]
