"""What a scan found, added to configurations of many kinds."""

from pathlib import Path

import pytest

from gateway.config import ConfigError
from gateway.scan.fragment import check, merged

FILE = Path("gateway.toml")
BEGUN = '[machine]\nname = "mill"\n'


def test_file_that_was_broken_during_the_scan_is_told() -> None:
    with pytest.raises(ConfigError, match=r"^gateway\.toml: is not valid TOML: .*line 3"):
        merged(BEGUN + "[[bus]\n", (), FILE)


@pytest.mark.parametrize("text", ["", "\n", BEGUN])
def test_file_that_is_only_begun_can_be_added_to(text: str) -> None:
    check(text, FILE)
