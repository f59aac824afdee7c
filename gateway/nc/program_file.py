"""The NC program of route `errors` for the machine of a configuration."""

from drivers.base import SetupError
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import SinumerikSettings
from gateway.config.controls import SinumerikNc
from gateway.config.model import GatewayConfig


def program_of(config: GatewayConfig) -> str:
    """TALC_ERRORS.SPF. Raises SetupError for another control or route."""
    if not isinstance(config.nc, SinumerikNc):
        raise SetupError("CONFIG has no control of kind = 'sinumerik'")
    settings: SinumerikSettings = config.nc.settings(config.probing.poses_deg, ())
    comp = config.compensation
    return errors_program(settings, ErrorTerms(comp.slew_um_per_s, config.probing.sphere_radius_mm, comp.bound_um))
