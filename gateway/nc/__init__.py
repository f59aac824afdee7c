"""What goes to the numerical control: bounded, slewed, under a lease, read back."""
