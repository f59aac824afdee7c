"""Says what the configuration leaves off, and what will therefore not happen, so that nobody waits for it."""

from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


def unarmed(config: GatewayConfig) -> tuple[Text, ...]:
    """One text per consequence, with what would change it; empty when the gateway learns, corrects and publishes."""
    found = []
    if not config.machine.corrected:
        found.append(Text(NoticeCode.OFF_CHAIN, chain=config.machine.chain))
    elif config.nc is None:
        found.append(Text(NoticeCode.OFF_NO_NC))
    elif config.nc.only_read:
        found.append(Text(NoticeCode.OFF_ONLY_READ, kind=config.nc.kind))
    else:
        if not config.probing.armed:
            found.append(Text(NoticeCode.OFF_PROBING))
        if config.compensation.mode != "compensate":
            found.append(Text(NoticeCode.OFF_MODE, mode=config.compensation.mode))
    if not config.telemetry.enabled:
        found.append(Text(NoticeCode.OFF_TELEMETRY))
    elif not (config.telemetry.listening or config.telemetry.connect or config.telemetry.multicast):
        found.append(Text(NoticeCode.OFF_LISTEN))
    return tuple(found)
