"""Devices that no profile describes, read by hand; and drafts of profiles for them. It only reads."""
