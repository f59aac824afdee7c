"""`talc-gateway opcua`: shows machines to OPC UA clients. It only listens, so it cannot affect a machine."""

from pathlib import Path

import click

from gateway.cli.arguments import address_of, heard_options, print_hash, read_config


@click.command()
@heard_options
@click.option("--settings", type=click.Path(dir_okay=False, path_type=Path),
              help="TOML file: nameplates, certificate, users (docs/umati.md).")  # fmt: skip
@click.option("--listen", default="127.0.0.1:4840", show_default=True, metavar="HOST:PORT",
              help="Address of the server.")  # fmt: skip
@click.option("--make-password", is_flag=True, help="Ask for a password, print its hash for --settings, and end.")
def opcua(
    config: Path | None,
    connect: tuple[str, ...],
    prefix: str | None,
    settings: Path | None,
    listen: str,
    make_password: bool,
) -> None:
    """Show machines to OPC UA clients after OPC UA for Machine Tools (umati), read-only.

    Shows the gateway of CONFIG, which runs on this computer, and the machines that --settings names and --connect
    reaches. It only listens: no client can touch a machine. An address beyond this computer needs a certificate and
    users in --settings.
    """
    if make_password:
        print_hash()
        return
    if config is None and not connect:
        raise click.UsageError("give CONFIG, or --connect ENDPOINT")
    from gateway.listeners.umati.serve import serve_machines

    host, port = address_of(listen)
    serve_machines(None if config is None else read_config(config), connect, prefix, settings, host, port)
