"""`python -m simulators.bench`."""

from simulators.bench.process import main

main()
