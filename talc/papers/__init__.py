"""What is not the default: the papers' phases, and the selectors and fits of the models that they train."""
