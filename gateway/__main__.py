"""`python -m gateway` is `talc-gateway`."""

from gateway.cli.main import main

main()
