"""Reads every device of every bus once per period, checks the values, and reports problems."""
