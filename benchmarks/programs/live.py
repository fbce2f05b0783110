"""The live engine on the simulated rig: latency, frames lost, processor time and memory.

By hand: ``python -m benchmarks.programs.live [--seconds S] [--preset 240hz] [--record FILE] [--here] [--track]``; it
prints one line of a Markdown table, and what was lost. A soak is ``--seconds 600``.
"""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.rigs.engine_run import run_engine
from benchmarks.rigs.engines import Apart, Here
from napari_elsplus.instrument.optics import PRESETS

TITLES = (
    "run", "frames", "lost", "median ms", "p99 ms", "99.9 % ms", "largest ms",
    "processor us/frame", "memory MB, growth", "looks/s",
)  # fmt: skip


@click.command()
@click.option("--seconds", default=60.0, help="How long, after three seconds to settle.")
@click.option("--preset", "name", type=click.Choice(list(PRESETS)), default="240hz")
@click.option("--record", type=click.Path(path_type=Path), help="Record, too.")
@click.option("--here", is_flag=True, help="The engine in this process; else in one of its own, as for napari.")
@click.option("--track", is_flag=True, help="Track and lay a mosaic, too; only with --here.")
@click.option("--header", is_flag=True, help="Print the table's header before.")
def main(seconds: float, name: str, record: Path | None, here: bool, track: bool, header: bool) -> None:
    """Stream for some seconds; the simulator runs in the engine's process."""
    if track and not here:
        raise click.UsageError("--track needs --here")
    run = run_engine(Here(name, track=track) if here else Apart(name), seconds, record=record)
    if header:
        click.echo("| " + " | ".join(TITLES) + " |\n" + "|---" * len(TITLES) + "|")
    status, latency_ms = run.status, run.status.latency_ms
    title = f"{name}, {'one process' if here else 'two processes'}"
    title += (", recording" if record else "") + (", mosaic" if track else "") + f", {run.measured_s:.0f} s"
    cells = (
        title,
        status.acquired,
        run.lost,
        *(f"{ms:.1f}" for ms in (latency_ms.p50, latency_ms.p99, latency_ms.p999, latency_ms.max)),
        f"{run.cpu_us_per_frame:.0f}",
        f"{run.memory_mb[-1]:.0f}, {run.growth_percent:+.2f} %",
        f"{run.looks / run.measured_s:.0f}",
    )
    click.echo("| " + " | ".join(str(cell) for cell in cells) + " |")
    for cause, count in status.dropped.items():
        click.echo(f"lost: {count} {cause}", err=True)
    for fault in status.faults:
        click.echo(f"fault: {fault}", err=True)


if __name__ == "__main__":
    main()
