"""Drivers: how to read one device or control. They know neither TALC nor the gateway: no retries, no schedules."""
