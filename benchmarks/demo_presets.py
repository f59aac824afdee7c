"""The papers' complete systems beside the learner on the demo's machine, in simulated time, on five seeds."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product

from benchmarks.demo import DemoLoop, spread
from benchmarks.demo_models import CALIBRATION_S, HOURS, NAMES, UNITS, LaterHours, later
from benchmarks.rows import BenchRow
from talc.presets import PRESETS, preset
from talc.settings import TalcSettings

SEEDS = range(1, 6)
LEARNER = "learner"


def run_system(seed: int, name: str) -> LaterHours:
    """72 h of the demo; name: a preset, or the learner with its default settings."""
    settings = TalcSettings(method="learner") if name == LEARNER else preset(name)
    return later(DemoLoop(seed, HOURS, settings).run(), CALIBRATION_S)


def rows() -> list[BenchRow]:
    """All rows of the table; takes some ten minutes of a core."""
    pairs = list(product((LEARNER, *PRESETS), SEEDS))
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(run_system, [seed for _, seed in pairs], [name for name, _ in pairs]))
    systems = {name: found[i * len(SEEDS) :][: len(SEEDS)] for i, name in enumerate((LEARNER, *PRESETS))}
    return list(system_table(systems))


def system_table(systems: Mapping[str, Sequence[LaterHours]]) -> Iterator[BenchRow]:
    """Medians and ranges; runs of the same seed stand at the same place."""
    own, others = systems[LEARNER], {name: runs for name, runs in systems.items() if name != LEARNER}
    for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        beside = [f"{spread([r.left[i] for r in runs])} {other}" for other, runs in others.items()]
        without = f"{spread([r.without[i] for r in own])} without"
        yield BenchRow(
            f"{name}, E_RMS, {unit}", f"{spread([r.left[i] for r in own])} learner", "; ".join((*beside, without))
        )
    made = {name: spread([float(r.measurements) for r in runs], 0) for name, runs in systems.items()}
    beside = [f"{count} {name}" for name, count in made.items() if name != LEARNER]
    yield BenchRow("measurements in 72 h", made[LEARNER], "; ".join(beside))
