"""The live engine in a process of its own for a long time, as napari uses it: ``python3 run.py bench soak``."""

from __future__ import annotations

import click
import numpy as np

from benchmarks.rigs.engine_run import run_engine
from benchmarks.rigs.engines import Apart
from napari_elsplus.instrument.optics import PRESETS


@click.command()
@click.option("--seconds", default=600.0, show_default=True, help="How long, after three seconds to settle.")
@click.option("--preset", type=click.Choice(list(PRESETS)), default="240hz", show_default=True)
def soak(seconds: float, preset: str) -> None:
    """Stream for a long time on the simulated rig: frames lost, lateness, and whether memory grows."""
    run = run_engine(Apart(preset), seconds)
    latency_ms, tenth = run.status.latency_ms, max(1, len(run.memory_mb) // 10)
    first_mb, last_mb = (float(np.median(part)) for part in (run.memory_mb[:tenth], run.memory_mb[-tenth:]))
    causes = "; ".join(f"{count} {cause}" for cause, count in run.status.dropped.items())
    click.echo(
        f"{preset}: {run.status.acquired} frames, {run.lost} lost {causes}\n"
        f"latency: median {latency_ms.p50:.1f} ms, 99 % {latency_ms.p99:.1f} ms, longest {latency_ms.max:.1f} ms\n"
        f"{run.cpu_us_per_frame:.0f} us of a core a frame; memory {last_mb:.0f} MB in the last tenth, "
        f"{100 * (last_mb / first_mb - 1):+.2f} % against the first\n"
        f"faults: {'; '.join(map(str, run.status.faults)) or 'none'}"
    )
