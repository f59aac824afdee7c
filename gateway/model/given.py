"""What somebody gave and the program cannot use."""


class GivenError(Exception):
    """A file or an argument cannot be used. Nothing has been done; the text says where and what is wrong."""
