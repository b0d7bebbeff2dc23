"""All commands; each one imports what it needs when it runs."""

from __future__ import annotations

from typing import Annotated

import typer

from uavbatt import __version__
from uavbatt.cli import batteries, diagnose, fit, fleet, info, live, packs, plan, replay, simulate, validate

app = typer.Typer(
    name="uavbatt",
    help="How long a drone can keep flying, how sure that number is, and why it can be trusted. "
    "`uavbatt LOG` replays a log.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"uavbatt {__version__}")
        raise typer.Exit


@app.callback()
def _top(
    version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True)] = False,
) -> None:
    """Take the options before the command."""


app.command("replay")(replay.replay)
app.command("live")(live.live)
app.command("plan")(plan.plan)
app.command("fit")(fit.fit)
app.command("validate")(validate.validate)
app.command("diagnose")(diagnose.diagnose)
app.command("packs")(packs.packs)
app.command("fleet")(fleet.fleet)
app.command("info")(info.info)
app.command("batteries")(batteries.batteries)
app.command("simulate")(simulate.simulate)
