"""The service: configuration, acquisition, control loop, storage, telemetry, command line; all policy lives here."""
