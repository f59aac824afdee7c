"""Lives of the whole core, each drawn from a seed: `python -m tests.benches.drawn_lives --seeds 0..9999`."""
