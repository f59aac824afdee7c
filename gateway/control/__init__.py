"""The grid loop around the pure controller, and what computes beside it."""
