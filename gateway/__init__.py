"""The service: configuration, acquisition, control loop, storage, telemetry and command line. It holds all policy."""
