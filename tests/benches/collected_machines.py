"""Machines that have run, and a collector that has everything they stored."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np

from gateway.config.file import load
from gateway.listeners.collect.collector import Collector
from gateway.listeners.collect.places import site_at
from gateway.model.events import DecisionMade, FrameMade
from gateway.storage.store import Store
from talc.frame import Frame, Measurement
from tests.benches import telemetry_examples as example
from tests.benches.machines_of_a_kind import CHANNELS, day, frames, written
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_site import StoredSite

STEPS = 150
FIRST_K = 5_900_000
OTHER_ORDER = (*CHANNELS[6:], *CHANNELS[:6])


def spoilt(seed: int) -> Iterator[Frame]:
    """Steps as a machine has them: gaps, inputs without a good value, errors that a cycle does not determine, and a
    start without a clock."""
    for n, frame in enumerate(frames(day(seed))[:STEPS]):
        if 50 <= n < 54:
            continue
        here = replace(frame, k=FIRST_K + n, pause_unknown=n == 90)
        if n % 7 == 3:
            valid = np.arange(len(CHANNELS)) != seed % 5
            here = replace(here, valid=valid, inputs=np.where(valid, here.inputs, 1e300))
        if n == 33 and here.measurement is not None:
            errors = np.where(np.arange(9) == 4, np.nan, here.measurement.errors)
            here = replace(here, measurement=Measurement(errors, here.measurement.sigma * 3.0))
        yield here


def work(folder: Path, seed: int, kind: str | None = None) -> None:
    """A machine that ran, and after a restart with its channels in another order."""
    found, places = list(spoilt(seed)), [CHANNELS.index(name) for name in OTHER_ORDER]
    rest = [replace(f, inputs=f.inputs[places], valid=f.valid[places]) for f in found[70:]]
    for channels, some in ((CHANNELS, found[:70]), (OTHER_ORDER, rest)):
        config = load(written(folder, f"mill{seed}", channels=channels, kind=kind))
        with Store(config.storage.path, f"run{some[0].k}", SteppedClock(), commit_s=60.0) as store:
            store.begin(config.canonical(), config.fingerprint(), "")
            for frame in some:
                store.record(FrameMade(frame))
                store.record(DecisionMade(replace(example.DECISION, k=frame.k)))


def collected(gateways: Path, site: str) -> None:
    """Collect all that these gateways have stored, in a folder or in the database at an address."""
    with site_at(site) as kept:
        collecting = Collector(StoredSite(gateways), kept, limit=100)
        for turn in count():
            if collecting.turn(0.0) > 0.0 and turn:
                break
    assert not [asked.problem for asked in collecting.machines.values() if asked.problem]
