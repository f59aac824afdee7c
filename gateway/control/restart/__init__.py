"""State that an earlier run left in the store, the controller rebuilt from it, and snapshots for the next run."""
