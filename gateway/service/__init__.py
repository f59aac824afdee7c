"""The running gateway: its parts composed, their health and metrics, its answers to queries and commands."""
