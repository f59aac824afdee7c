"""`python -m tests.benches.demo_picture FOLDER PICTURE`: the picture that heads the README.

It is of the page of the demo in that folder, when `demo --replay` has played its days again.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image

from tests.benches.free_port import free_port
from tests.benches.page_rig import LIMIT_MS, ChildProgram, chromium

_STANDS = """() => {
  const shown = document.querySelector("#heard b")?.textContent;
  if (shown !== window.shown) [window.shown, window.since] = [shown, performance.now()];
  return Boolean(shown) && performance.now() - window.since > 5000; }"""
"""Its simulated clock has stopped."""


def main(folder: Path, picture: Path) -> None:
    """Play, and write the picture."""
    played = ("gateway", "demo", "--replay", "--folder", str(folder), "--zenoh-port", str(free_port()))
    replay = ChildProgram(*played)
    try:
        address = next(word for word in replay.hear().split() if word.startswith("http"))
        with chromium() as browser:
            page = browser.new_page(viewport={"width": 1400, "height": 900}, locale="en-GB", timezone_id="UTC")
            page.goto(address)
            page.wait_for_function(_STANDS, polling=500, timeout=5 * LIMIT_MS)
            with Image.open(BytesIO(page.screenshot())) as shown:
                shown.quantize(128).save(picture, optimize=True)
    finally:
        replay.kill()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
