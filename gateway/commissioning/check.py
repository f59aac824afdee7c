"""What `talc-gateway check` says of a configuration."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from gateway.commissioning.scan.first import to_confirm
from gateway.config.consequences import unarmed
from gateway.config.model import GatewayConfig
from gateway.config.prior import described
from gateway.config.problems import ConfigError
from gateway.config.reading import read_text
from gateway.config.telemetry_rules import credential_problems
from gateway.control.restart.proven import dry_run_wanted
from gateway.service.opening import armed, contents


def checked_lines(path: Path, config: GatewayConfig, kinds: Sequence[str]) -> Iterator[str]:
    """Line by line. Raises ConfigError if its certificates, keys or passwords are of no use.

    kinds: of other packages that can be used
    """
    if wrong := list(credential_problems(config.telemetry, datetime.now(UTC))):
        raise ConfigError(path, wrong)
    prior = "" if config.prior is None else f"; {described(config.prior, config.input_names)}"
    yield f"{path}: good. {contents(config)}; {armed(config)}; fingerprint {config.fingerprint()[:16]}{prior}"
    if kinds:
        yield f"kinds of other packages: {', '.join(kinds)}"
    yield from filter(None, (*unarmed(config), dry_run_wanted(config)))
    if guesses := to_confirm(read_text(path)):
        yield f"still to confirm: {len(guesses)} (line {', '.join(str(number) for number, _ in guesses)})"
