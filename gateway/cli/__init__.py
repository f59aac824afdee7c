"""The command line `talc-gateway`."""
