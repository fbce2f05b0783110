"""The live engine on the simulated rig: latency, frames lost, processor time and memory.

By hand: ``python benchmarks/live.py [--seconds S] [--preset 240hz] [--record FILE] [--track]``; it prints one line of
a Markdown table.
"""

from __future__ import annotations

import resource
import time
from pathlib import Path

import click

from napari_elsplus.acquisition.engine import Engine
from napari_elsplus.acquisition.priority import keep_pace
from napari_elsplus.acquisition.recorder import RecordingPlan
from napari_elsplus.acquisition.simulated import open_live
from napari_elsplus.acquisition.status import Settings
from napari_elsplus.acquisition.tracking import LiveTrack
from napari_elsplus.optics import PRESETS, preset


def resident_mb() -> float:
    """Memory of this process that is not shared with files, where the system tells; else the largest so far."""
    status = Path("/proc/self/status")
    if status.exists():
        fields = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return int(fields["RssAnon"].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@click.command()
@click.option("--seconds", default=60.0)
@click.option("--preset", "name", type=click.Choice(list(PRESETS)), default="240hz")
@click.option("--record", type=click.Path(path_type=Path))
@click.option("--track", is_flag=True)
def main(seconds: float, name: str, record: Path | None, track: bool) -> None:
    """Stream, with the simulator in the same process."""
    keep_pace()
    rig = open_live("simulated")
    with Engine(rig) as engine:
        engine.configure(Settings(name))
        engine.use(rig.bench.optics.calibration(preset(name)))
        if track:
            engine.track(LiveTrack(engine.calibration, engine.setup.frame_shape))
        engine.start()
        if record is not None:
            engine.record(RecordingPlan(record, earlier_s=2.0, force=True))
        time.sleep(min(3.0, seconds / 4))
        memory_mb, spent_s = resident_mb(), time.process_time()
        time.sleep(seconds)
        growth = 100 * (resident_mb() / memory_mb - 1)
        used = (time.process_time() - spent_s) / seconds
        engine.stop()
        engine.finish_recording()
        status = engine.status()
    latency = status.latency_ms
    click.echo(
        f"| {name}{', recording' if record else ''}{', mosaic' if track else ''} | {status.acquired} "
        f"| {sum(status.dropped.values())} | {latency.p50:.1f} | {latency.p99:.1f} | {latency.max:.1f} "
        f"| {used:.2f} | {memory_mb:.0f} MB, {growth:+.1f} % |"
    )


if __name__ == "__main__":
    main()
