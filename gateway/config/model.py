"""The whole configuration of a gateway as one frozen value."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Self

from pydantic import Field, PrivateAttr

from drivers.profile import DeviceProfile
from drivers.profiles import UserProfile
from drivers.section import Section
from gateway.config.buses import AnyBusSection
from gateway.config.controls import Nc
from gateway.config.metrics import Metrics
from gateway.config.prior import PriorFile
from gateway.config.sections import (
    DEFAULT_DATABASE,
    Compensation,
    Device,
    Grid,
    Instrument,
    Limits,
    MachineSection,
    PlannedLoad,
    Probing,
    State,
    Storage,
    Talc,
)
from gateway.config.telemetry import Telemetry
from talc.settings import SensorCheckSettings, TalcSettings


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of the configuration, with everything that belongs to it."""

    name: str
    device: str
    bus: str
    period_s: float
    limits: Limits


class GatewayConfig(Section):
    """One gateway: machine, inputs, buses, devices, NC, TALC settings, telemetry, storage."""

    machine: MachineSection
    grid: Grid = Grid()
    storage: Storage = Storage()
    telemetry: Telemetry = Telemetry()
    metrics: Metrics = Metrics()
    buses: tuple[AnyBusSection, ...] = Field(default=(), alias="bus")
    devices: tuple[Device, ...] = Field(default=(), alias="device")
    states: tuple[State, ...] = Field(default=(), alias="state")
    planned_loads: tuple[PlannedLoad, ...] = Field(default=(), alias="planned_load", max_length=8)
    instruments: tuple[Instrument, ...] = Field(default=(), alias="instrument", max_length=40)
    limits: Mapping[str, Limits] = Field(default_factory=dict)
    nc: Nc | None = None
    probing: Probing = Probing()
    compensation: Compensation = Compensation()
    talc: Talc = TalcSettings()
    sensor_check: SensorCheckSettings = SensorCheckSettings()
    _profiles: Mapping[str, UserProfile] = PrivateAttr(default_factory=dict)
    """Not a key of the file, nor in `canonical()`, because earlier programs must still read the database."""
    _prior: PriorFile | None = PrivateAttr(default=None)

    @property
    def profiles(self) -> Mapping[str, UserProfile]:
        """The content of the user's own profiles when this configuration was loaded, by `profile` of a device."""
        return self._profiles

    def profile_of(self, device: Device) -> str | DeviceProfile:
        """A device's profile: the user's own as it was when this configuration was loaded, or a supplied one's name."""
        own = self._profiles.get(device.profile)
        return device.profile if own is None else own.profile

    def with_profiles(self, profiles: Mapping[str, UserProfile]) -> Self:
        """A copy with these user profiles."""
        config = self.model_copy()
        config._profiles = dict(profiles)  # noqa: SLF001 - a copy of this class
        return config

    @property
    def prior(self) -> PriorFile | None:
        """The content of the `[talc] prior` file when this configuration was loaded, or the database's copy of it."""
        return self._prior

    def with_prior(self, prior: PriorFile | None) -> Self:
        """A copy with this prior."""
        config = self.model_copy()
        config._prior = prior  # noqa: SLF001 - a copy of this class
        return config

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel, in file order."""
        periods = {bus.name: bus.period_s for bus in self.buses}
        return tuple(
            Channel(name, device.name, device.bus, periods[device.bus], self.limits.get(name, Limits()))
            for device in self.devices
            for name in device.channels
        )

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the model inputs, in the order of a frame: channels in file order, then machine states that are
        inputs."""
        channels = (name for device in self.devices for name in device.channels)
        return (*channels, *(state.name for state in self.states if state.use == "input"))

    @property
    def tolerance_state(self) -> str | None:
        """The machine state that is the stated tolerance; None: there is none."""
        return next((state.name for state in self.states if state.use == "tolerance"), None)

    def devices_of(self, bus: str) -> tuple[Device, ...]:
        """The devices on one bus, in file order."""
        return tuple(device for device in self.devices if device.bus == bus)

    def canonical(self) -> str:
        """The configuration with every default written out, as JSON: the same text for the same behaviour.

        It contains what the file says; the content of user profiles and of a prior is in the fingerprint only.
        """
        return json.dumps(self.model_dump(mode="json", by_alias=True), sort_keys=False, separators=(",", ":"))

    def fingerprint(self) -> str:
        """SHA-256, hexadecimal, of `canonical()` and of the hashes of the user's own profiles and of the prior, if any.

        It identifies what runs, not how its file is laid out.
        """
        others = [f"\n{name} {self._profiles[name].content_hash}" for name in sorted(self._profiles)]
        if self._prior is not None:
            others.append(f"\n{self._prior.content_hash}")
        return sha256((self.canonical() + "".join(others)).encode()).hexdigest()


def with_database(data: Mapping[str, object]) -> Mapping[str, object]:
    """Writes out the database's default path: like any path of the file, it then starts at the file's folder."""
    storage = data.get("storage", {})
    return {**data, "storage": {"path": DEFAULT_DATABASE, **storage}} if isinstance(storage, Mapping) else data
