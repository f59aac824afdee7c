"""Lives of many seeds: `python -m tests.benches.drawn_lives --seeds 0..9999`; one: `--seeds 17`."""

import logging
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from tests.benches.drawn_lives.life import Life, Lived
from tests.benches.drawn_lives.plan import drawn
from tests.benches.failing_disk import on_failing_disk

_IN_MEMORY = Path("/dev/shm")


def _seeds(_: click.Context, __: click.Parameter, given: str) -> list[int]:
    found: list[int] = []
    for part in given.split(","):
        first, _dots, last = part.partition("..")
        found += range(int(first), int(last or first) + 1)
    return found


@click.command()
@click.option("--seeds", default="0..29", show_default=True, callback=_seeds, help="Such as 0..29 or 3,17.")
@click.option("--show", "shows", is_flag=True, help="Show what happens in each.")
def main(seeds: list[int], shows: bool) -> None:
    """Exit code 1: something was not as it must be. Each such life is one line, with the seed that repeats it."""
    if "FAILING_DISK" not in os.environ:  # the layer that refuses calls must be there before Python
        with TemporaryDirectory(dir=_IN_MEMORY if _IN_MEMORY.is_dir() else None) as name:
            command = [sys.executable, "-m", "tests.benches.drawn_lives", *sys.argv[1:]]
            sys.exit(subprocess.run(command, env=on_failing_disk(Path(name)), check=False).returncode)
    logging.disable(logging.CRITICAL)
    began_s, lives = time.process_time(), list[Lived]()
    with suppress(KeyboardInterrupt):
        for seed in seeds:
            plan = drawn(seed)
            for one in plan.troubles if shows else ():
                click.echo(f"{one}")
            with TemporaryDirectory(dir=os.environ["FAILING_DISK"]) as folder, TemporaryDirectory() as keys:
                lived = Life(plan, Path(folder), Path(keys) / "key").live()
            lives.append(lived)
            if lived.wrong:
                click.echo(f"seed {seed} ({plan}): {'; '.join(lived.wrong)}")
    failed = sum(bool(one.wrong) for one in lives)
    click.echo(
        f"{len(lives)} lives, {failed} wrong, {sum(one.plan.lasts_s for one in lives) / 3600:.0f} h in "
        f"{time.process_time() - began_s:.1f} s: {sum(one.runs for one in lives)} starts, "
        f"{sum(one.steps for one in lives)} steps, {sum(one.unstored for one in lives)} of them or starts on a failing "
        f"disk, {sum(one.measured for one in lives)} measurements, {sum(one.good for one in lives)} good readings, "
        f"offsets moved in {sum(one.largest_um > 2.0 for one in lives)}"
    )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
