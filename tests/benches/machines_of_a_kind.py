"""Machines of one kind: their configurations, days of the same physics under other loads, and what they store."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.config.model import GatewayConfig
from gateway.control.restart.rebuild import controller_of
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Frame, Measurement
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_steps import record_step
from tests.benches.thermal_series import ThermalSeries, series

DAY = 288
CHANNELS = tuple(f"t{i}" for i in range(12))


def written(
    folder: Path, name: str, prior: str | None = None, channels: tuple[str, ...] = CHANNELS, kind: str | None = None
) -> Path:
    """A configuration with twelve temperatures on two modules."""
    talc = "" if prior is None else f'[talc]\nprior = "{prior}"\n'
    of_kind = "" if kind is None else f'kind = "{kind}"\n'
    modules = "".join(
        f'[[device]]\nname = "adam{unit}"\nbus = "tcp1"\nprofile = "advantech_adam6015"\nunit = {unit}\n'
        "[device.channels]\n" + "".join(f"{c} = {i}\n" for i, c in enumerate(channels[6 * unit - 6 : 6 * unit]))
        for unit in (1, 2)
    )
    path = folder / f"{name}.toml"
    path.write_text(
        f'[machine]\nname = "{name}"\n{of_kind}[storage]\npath = "{name}.sqlite"\n{talc}'
        f'[[bus]]\nname = "tcp1"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\n{modules}',
        encoding="utf-8",
    )
    return path


def day(seed: int) -> ThermalSeries:
    """A day of the machine with that number."""
    made = series(DAY, seed)
    return replace(made, truth=made.truth - made.truth[0], measured=made.measured - made.truth[0])


def frames(days: ThermalSeries) -> list[Frame]:
    """With a measurement each 55 min."""
    good, sigma = np.ones(len(days.names), dtype=np.bool_), np.full(9, 0.5)
    return [
        Frame(k, row, good, Measurement(days.measured[k], sigma) if k % 11 == 0 else None)
        for k, row in enumerate(days.inputs)
    ]


def store_run(config: GatewayConfig, found: list[Frame], controller: Controller | None = None) -> None:
    """What a gateway stores of a run."""
    controller = controller or controller_of(config)
    prior = None if config.prior is None else (config.prior.content_hash, config.prior.text)
    with Store(config.storage.path, f"run{found[0].k}", SteppedClock(), commit_s=60.0) as store:
        store.begin(config.canonical(), config.fingerprint(), "", prior)
        for frame in found:
            record_step(store, controller, frame)


def talc_gateway(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
