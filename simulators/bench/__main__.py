"""`python -m simulators.bench`."""

import os

# The plant's matrices are small: a second BLAS thread only takes the core that the gateway needs.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from simulators.bench.process import main

main()
