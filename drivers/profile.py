"""The fields that every profile has."""

from collections.abc import Mapping

from pydantic import PrivateAttr

from drivers.section import Section


class DeviceProfile(Section):
    """Any profile. `name` of the validation context is its name: that of its file, without the ending."""

    title: str
    """What the device is, for a person."""
    unit: str
    """Of every channel."""
    confirm: tuple[str, ...] = ()
    """What was not found in a manual: check it on the device."""
    _name: str = PrivateAttr(default="")

    def model_post_init(self, context: Mapping[str, object] | None) -> None:
        """Take the name."""
        if context is not None:
            self._name = str(context["name"])

    @property
    def name(self) -> str:
        """What a configuration calls it."""
        return self._name
