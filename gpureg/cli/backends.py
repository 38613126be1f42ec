"""``gpureg backends``: list the devices."""

from __future__ import annotations

import json
import sys

import click

from .. import backends
from .options import examples


def _gibibytes(count: int) -> str:
    return f"{count / 2**30:.1f} GiB" if count else "?"


@click.command(
    "backends",
    short_help="List the available devices.",
    epilog=examples("GPUREG_BACKEND=warp:cpu gpureg denoise noisy.png clean.png"),
)
@click.option("--json", "as_json", is_flag=True, help="Write JSON.")
def list_backends(as_json: bool) -> None:
    """List the devices that gpureg can use, the one that `auto` takes, and why the others are left out."""
    found, absent, left_out = backends.devices(), backends.absent(), backends.left_out()
    code = 0
    try:
        taken, why = backends.get("auto").device.id, backends.why_auto()
    except (ValueError, backends.BackendUnavailable) as error:
        # GPUREG_BACKEND names a device that does not exist: the table shows the existing ones.
        taken, why, code = "", str(error), 2 if isinstance(error, ValueError) else 1
    if as_json:
        rows = [
            {
                "id": device.id,
                "device": device.name,
                "driver": device.driver,
                "kind": device.kind,
                "memory_bytes": device.memory,
                "vector_width": device.vector_width,
                "float64": device.float64,
                "auto": device.id == taken,
            }
            for device in found
        ]
        unfit = [{"id": one.id, "device": one.name, "reason": one.reason} for one in left_out]
        click.echo(json.dumps({"devices": rows, "absent": absent, "left_out": unfit, "auto": why}, indent=2))
        raise click.exceptions.Exit(code)
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("", "name", "device", "driver", "kind", "memory", "vector", "float64"):
        table.add_column(heading, overflow="fold")
    for device in found:
        table.add_row(
            "*" if device.id == taken else "",
            device.id,
            device.name,
            device.driver,
            device.kind,
            _gibibytes(device.memory),
            str(device.vector_width),
            "yes" if device.float64 else "no",
        )
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False)
    console.print(table)
    click.echo(f"\n* {why}")
    for name, problem in absent.items():
        click.echo(f"  {name}: {problem}")
    for one in left_out:
        if one.id.partition(":")[0] not in absent:
            click.echo(f"  {one}")
    raise click.exceptions.Exit(code)
