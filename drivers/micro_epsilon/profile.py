"""Profiles of displacement sensors: payload form and scaling."""

from dataclasses import dataclass

from drivers.toml_table import Table


@dataclass(frozen=True, slots=True)
class MeRs485Profile:
    """A Micro-Epsilon sensor with RS-485 framing."""

    name: str
    title: str
    channels: int
    unit: str
    confirm: tuple[str, ...]
    payload: str
    """`float`: two float32, unscaled and scaled. `counted`: u16 counter, u8 number, filler, int32 values (DT6120)."""
    full_scale: float
    """Raw value at the end of the measuring range."""

    @property
    def buses(self) -> tuple[str, ...]:
        return ("me_rs485",)


def me_rs485_profile(name: str, table: Table) -> MeRs485Profile:
    """Read a profile of `protocol = "me_rs485"`. Raises SetupError."""
    value = table.table("value")
    profile = MeRs485Profile(
        name=name,
        title=table.text("title"),
        channels=table.integer("channels", low=1, high=1),
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        payload=value.text("payload", choices=("float", "counted")),
        full_scale=value.number("full_scale"),
    )
    if profile.full_scale <= 0:
        raise value.error("full_scale", f"{profile.full_scale} is not above 0")
    value.finish()
    table.finish()
    return profile


@dataclass(frozen=True, slots=True)
class MeEthernetProfile:
    """A Micro-Epsilon controller that streams on Ethernet."""

    name: str
    title: str
    channels: int
    unit: str
    confirm: tuple[str, ...]
    full_scale: float
    """Raw value at the end of the measuring range."""

    @property
    def buses(self) -> tuple[str, ...]:
        return ("me_ethernet",)


def me_ethernet_profile(name: str, table: Table) -> MeEthernetProfile:
    """Read a profile of `protocol = "me_ethernet"`. Raises SetupError."""
    value = table.table("value")
    profile = MeEthernetProfile(
        name=name,
        title=table.text("title"),
        channels=table.integer("channels", low=1, high=32),
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        full_scale=value.number("full_scale"),
    )
    if profile.full_scale <= 0:
        raise value.error("full_scale", f"{profile.full_scale} is not above 0")
    value.finish()
    table.finish()
    return profile
