#!/usr/bin/env python3
"""Makes a router's configuration from the list of a site: router_rules.py site.toml > router.json5

It needs only Python 3.11. Change the list, make the file again and restart the router; clients connect again by
themselves. The addresses and files stand in it as constants: change them in the result, or with sed.
"""

import json
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

_PREFIX = "talc"
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_LISTS = ("machines", "readers", "operators")
_SENDING = ["put", "delete", "declare_queryable", "reply", "liveliness_token"]
_READING = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
_HEAD = """\
// A plant's Zenoh router (zenohd -c router.json5): gateways publish to it, readers read from it, both by mutual TLS.
// Certificates: certificates.sh. Who may do what follows from the common name in a certificate; what no rule allows is
// denied. Made by router_rules.py from the list site.toml: change the list, not the rules.
{
  mode: "router",
  listen: { endpoints: ["tls/0.0.0.0:7447"] },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  timestamping: { enabled: true },
  transport: {
    link: {
      rx: { max_message_size: 16777216 },  // a page of history has a few MB; a larger message is dropped
      tls: {
        root_ca_certificate: "/etc/zenoh/authority.pem",
        listen_certificate: "/etc/zenoh/router.pem",
        listen_private_key: "/etc/zenoh/router.key",
        enable_mtls: true,
        close_link_on_expiration: true,
      },
    },
  },
  access_control:
"""


def rules(site: Mapping[str, Sequence[str]], prefix: str = _PREFIX) -> dict[str, object]:
    """Zenoh's access_control. A machine sends under its own keys only; its own programs read as readers do."""
    everything = [f"{prefix}/**"]
    found = [
        *(_rule(f"{name} sends", "allow", "ingress", _SENDING, [f"{prefix}/{name}/**"]) for name in site["machines"]),
        _rule("gateways are asked", "allow", "egress", _READING, everything),
        _rule("readers ask", "allow", "ingress", _READING, everything),
        _rule("readers hear", "allow", "egress", _SENDING, everything),
        # Commands are queries: this keeps all but operators from asking at all.
        _rule("readers give no commands", "deny", "ingress", ["query"], [f"{prefix}/*/command/**"]),
    ]
    subjects = [{"id": f"gateway of {name}", "cert_common_names": [name]} for name in site["machines"]]
    policies: list[dict[str, object]] = [
        {
            "rules": [f"{name} sends", "gateways are asked", "readers ask", "readers hear", "readers give no commands"],
            "subjects": [f"gateway of {name}"],
        }
        for name in site["machines"]
    ]
    for who, may in (
        ("readers", ["readers ask", "readers hear", "readers give no commands"]),
        ("operators", ["readers ask", "readers hear"]),
    ):
        if site[who]:
            subjects.append({"id": who, "cert_common_names": list(site[who])})
            policies.append({"rules": may, "subjects": [who]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": found,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, permission: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, object]:
    return {"id": name, "permission": permission, "flows": [flow], "messages": messages, "key_exprs": keys}


def read(path: Path) -> dict[str, list[str]]:
    """The list. Raises ValueError with what is wrong in it."""
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    if unknown := sorted(found.keys() - set(_LISTS)):
        raise ValueError(f"{', '.join(unknown)}: unknown; expected {', '.join(_LISTS)}")
    site = {name: found.get(name, []) for name in _LISTS}
    seen: dict[str, str] = {}
    for name, holders in site.items():
        if not (isinstance(holders, list) and all(isinstance(one, str) and _NAME.fullmatch(one) for one in holders)):
            raise ValueError(f"{name} = {holders!r}: expected a list of names of letters, digits, _, . and -")
        for holder in holders:
            if holder in seen:
                raise ValueError(f"{name}: {holder!r} is already in {seen[holder]}; each certificate has its own name")
            seen[holder] = name
    if not site["machines"]:
        raise ValueError("machines: empty; nobody could publish")
    return site


def made(site: Mapping[str, Sequence[str]]) -> str:
    """The text of router.json5."""
    text = json.dumps(rules(site), indent=2)
    return _HEAD + "\n".join(f"  {line}" for line in text.splitlines()) + ",\n}\n"


def main() -> int:
    """Print it; 2: the list is wrong."""
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        print(made(read(Path(sys.argv[1]))), end="")
    except (OSError, ValueError) as error:
        print(f"{sys.argv[1]}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
