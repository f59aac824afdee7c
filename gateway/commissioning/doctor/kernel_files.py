"""Reads the one-line files of /sys and /proc."""

from pathlib import Path


def kernel_text(file: Path) -> str:
    """Without its line end; empty: it is not there or cannot be read, or is no ASCII."""
    try:
        return file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""
