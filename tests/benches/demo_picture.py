"""`python -m tests.benches.demo_picture FOLDER PICTURE`: the page in motion that heads the README.

It is of the page of the demo in that folder, while `demo --replay` plays its days again.
"""

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image

from tests.benches.free_port import free_port
from tests.benches.page_rig import ChildProgram, chromium

_SIZE, _SHOWN = (1400, 900), (840, 540)
_EVERY_MS, _LAST_MS = 300, 4000
_ENDED = 5
"""So many equal clocks in a row: the replay is over."""


def main(folder: Path, picture: Path) -> None:
    """Play, and write the picture."""
    played = ("gateway", "demo", "--replay", "--folder", str(folder), "--zenoh-port", str(free_port()))
    replay, frames, clocks = ChildProgram(*played), list[Image.Image](), list[str]()
    try:
        address = next(word for word in replay.hear().split() if word.startswith("http"))
        with chromium() as browser:
            page = browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]}, locale="en-GB", timezone_id="UTC")
            page.goto(address)
            while not clocks or clocks[-_ENDED:] != clocks[-1:] * _ENDED:
                page.wait_for_timeout(1000.0)
                if not (clock := page.evaluate("document.querySelector('#heard b')?.textContent")):
                    continue
                clocks.append(clock)
                if clock not in clocks[:-1]:
                    with Image.open(BytesIO(page.screenshot())) as shown:
                        frames.append(shown.convert("RGB").resize(_SHOWN, Image.Resampling.LANCZOS))
    finally:
        replay.kill()
    durations = [*[_EVERY_MS] * (len(frames) - 1), _LAST_MS]
    frames[0].save(picture, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=60, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
