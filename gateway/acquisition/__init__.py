"""Reads every device of every bus once per period, and tells what is wrong with them."""
