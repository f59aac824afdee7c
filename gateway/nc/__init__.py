"""The link to the numerical control: offsets are bounded, slewed, written under a lease and read back."""
