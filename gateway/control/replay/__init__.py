"""Runs a controller on what is stored: a database, whose decisions it must repeat, or a user's recording."""
