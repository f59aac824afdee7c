"""`python -m gateway` is `talc-gateway`."""

from gateway.cli import main

main()
