"""When to ask the control for a probing cycle, and what its result is worth."""
