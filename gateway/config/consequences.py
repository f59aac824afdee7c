"""Says what the configuration leaves off, and what will therefore not happen, so that nobody waits for it."""

from gateway.config.model import GatewayConfig


def unarmed(config: GatewayConfig) -> tuple[str, ...]:
    """One text per consequence, with what would change it; empty when the gateway learns, corrects and publishes."""
    found = []
    if config.nc is None:
        found.append("nothing will be learnt and nothing corrected: there is no [nc]")
    elif config.nc.only_read:
        found.append(f"nothing will be learnt and nothing corrected: a control of kind '{config.nc.kind}' is only read")
    else:
        if not config.probing.armed:
            found.append("nothing will be learnt: probing is not armed ([probing] armed = true)")
        if config.compensation.mode != "compensate":
            mode = f"[compensation] mode is '{config.compensation.mode}'"
            found.append(f"nothing is written to the control: {mode}, not 'compensate'")
    if not config.telemetry.enabled:
        found.append("nothing is published: [telemetry] enabled = false")
    elif not (config.telemetry.listening or config.telemetry.connect or config.telemetry.multicast):
        found.append("nobody can receive what is published: [telemetry] has neither listen nor connect")
    return tuple(found)
