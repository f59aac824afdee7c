"""The NC program of route `errors` for the machine of a configuration."""

from pathlib import Path

from drivers.base import SetupError
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import SinumerikSettings
from gateway.config.controls import SinumerikNc
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError, Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from talc.kinematics import CHAIN


def write_program(config: Path, folder: Path) -> tuple[Path, int]:
    """Writes TALC_ERRORS.SPF for the machine of a configuration; the file, and how many synchronised actions it has.

    Raises ConfigError.
    """
    try:
        text = program_of(load(config))
    except SetupError as error:
        raise ConfigError(config, [Problem("[nc.compensation] route", error.what)]) from error
    path = folder / "TALC_ERRORS.SPF"
    path.write_text(text, encoding="ascii", newline="\r\n")
    return path, text.count("IDS=")


def program_of(config: GatewayConfig) -> str:
    """TALC_ERRORS.SPF. Raises SetupError for another control or route."""
    if not isinstance(config.nc, SinumerikNc):
        raise SetupError(Text(NoticeCode.NO_SINUMERIK))
    if not config.machine.corrected:
        raise SetupError(Text(NoticeCode.CHAIN_NOT_CORRECTED, value=config.machine.chain, corrected=CHAIN))
    settings: SinumerikSettings = config.nc.settings(config.probing.poses_deg, ())
    comp = config.compensation
    return errors_program(settings, ErrorTerms(comp.slew_um_per_s, config.probing.sphere_radius_mm, comp.bound_um))
