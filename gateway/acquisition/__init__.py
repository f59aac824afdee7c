"""Reads every device of every bus once per period, and reports problems."""
