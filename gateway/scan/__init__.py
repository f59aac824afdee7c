"""Finding what stands on a wire, for a configuration that is still to be written. Reads only."""
