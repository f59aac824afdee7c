"""The pages of a PDF, as another program reads them."""

import re
import subprocess
from pathlib import Path


def printed(paper: Path, form: str = "-layout") -> list[str]:
    """What pdftotext reads on each page. form: its option"""
    run = ["pdftotext", form, str(paper), "-"]
    found = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60).stdout
    return re.split(r"\f|</page>", found)[:-1]
