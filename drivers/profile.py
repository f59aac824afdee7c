"""The fields that every profile has."""

from collections.abc import Mapping

from pydantic import PrivateAttr

from drivers.section import Section


class DeviceProfile(Section):
    """Any profile. `name` in the validation context is its name: that of its file, without the suffix."""

    title: str
    """What the device is, for a person."""
    unit: str
    """Unit of every channel."""
    confirm: tuple[str, ...] = ()
    """Points that no manual confirms: check them on the device."""
    _name: str = PrivateAttr(default="")

    def model_post_init(self, context: Mapping[str, object] | None) -> None:
        """Set the name from the context."""
        if context is not None:
            self._name = str(context["name"])

    @property
    def name(self) -> str:
        """The profile's name in a configuration."""
        return self._name
