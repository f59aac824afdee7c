"""How to talk to one device. Knows neither TALC nor the gateway: no retries, no schedules, no policy."""
