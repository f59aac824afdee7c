"""Looks into a part of a gateway's configuration."""

import tomllib

from ansible.errors import AnsibleFilterError


def arms(text, name):
    """What in this part lets the gateway ask for probing cycles or write to the control; empty: nothing.

    Raises AnsibleFilterError if the part is not TOML; name: of its file, for that.
    """
    try:
        part = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise AnsibleFilterError(f"{name}: {error}") from error
    found = []
    if part.get("probing", {}).get("armed"):
        found.append("[probing] armed")
    if part.get("compensation", {}).get("mode") == "compensate":
        found.append("[compensation] mode")
    return found


class FilterModule:
    """Filters of this collection."""

    def filters(self):
        """By name."""
        return {"arms": arms}
