"""``simulate``: raw frames of the model instrument, with truth and calibration beside them."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from napari_elsplus.cli.options import (
    FILE,
    NUMBER,
    POSITIVE,
    SEED,
    LazyChoice,
    LazyHelp,
    force_option,
    output_option,
    progress,
    refuse_outputs,
)
from napari_elsplus.instrument.optics import PRESETS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from napari_elsplus.simulation.model.imperfections import Imperfections
    from napari_elsplus.workflows.simulated import SimulatedRecording


class _ImperfectionsType(click.ParamType):  # type: ignore[type-arg, unused-ignore] # generic since click 8.3
    """Text ``NAME=VALUE,...``."""

    name = "imperfections"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Imperfections:
        from napari_elsplus.simulation.model.imperfections import Imperfections

        return value if isinstance(value, Imperfections) else Imperfections.parse(value)


def _described_scenes() -> str:
    from napari_elsplus.simulation.specimen.scenes import SCENES

    return f"{', '.join(SCENES)}, plate:DEPTH_UM, or an image file."


def _described_paths() -> str:
    from napari_elsplus.simulation.specimen.trajectories import PATHS

    return f"{', '.join(PATHS)}, or a CSV file with columns time_s, row_um, col_um."


preset_option = click.option(
    "--preset",
    type=click.Choice(list(PRESETS)),
    default="240hz",
    show_default=True,
    help="Camera region and objective.",
)
offset_option = click.option(
    "--offset-um",
    type=NUMBER,
    default=-29.0,
    show_default=True,
    help="Slit offset; negative: the residual stands higher.",
)
slit_option = click.option("--slit-um", type=POSITIVE, help="Slit width, rounded to whole rows; 3 rows by default.")
seed_option = click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of scene and camera noise.")
imperfect_option = click.option(
    "--imperfect",
    "imperfections",
    type=_ImperfectionsType(),
    default="",
    metavar="NAME=VALUE,...",
    help="Departures from the ideal instrument: galvo-resonance=800,row-noise=0.5 for instance.",
)


state_option = click.option(
    "--state",
    type=LazyChoice("napari_elsplus.simulation.model.axial_response:LINE_MODELS"),
    default="a",
    show_default=True,
    help="Line model: of the paper's panels a and b, or the sharper one of c and d.",
)


@click.group()
def command() -> None:
    """Simulate raw frames of the model instrument, with truth and calibration beside them."""


@command.command()
@preset_option
@click.option(
    "--scene",
    "scene_name",
    cls=LazyHelp,
    default="fibres",
    show_default=True,
    describe=_described_scenes,
)
@click.option("--scene-um-per-px", type=POSITIVE, help="Scale of an image file; a camera pixel's by default.")
@click.option(
    "--path",
    cls=LazyHelp,
    default="hand",
    show_default=True,
    describe=_described_paths,
)
@click.option("--speed-um-s", type=NUMBER, default=2000.0, show_default=True, help="Speed of the probe.")
@click.option("--frames", type=click.IntRange(min=1), default=240, show_default=True, help="Number of frames.")
@click.option("--rate-hz", type=POSITIVE, help="Frames per second, below the preset's.")
@offset_option
@slit_option
@seed_option
@imperfect_option
@output_option
@force_option
def recording(output: Path, force: bool, scene_name: str, path: str, frames: int, preset: str, **options: Any) -> None:
    """Simulate a moving probe: raw frames, NAME.truth.json, NAME.calibration.json."""
    from napari_elsplus.io.disk import require_room
    from napari_elsplus.workflows.simulated import simulate_recording

    _refuse(output, force=force, inputs=[Path(name) for name in (scene_name, path) if Path(name).is_file()])
    require_room(output, frames * prod(PRESETS[preset].frame_shape))
    simulated = simulate_recording(scene_name=scene_name, path=path, frames=frames, preset=preset, **options)
    _save(simulated, output, force=force)


@command.command()
@click.option("--slit-um", type=POSITIVE, default=2.9, show_default=True, help="Slit width, rounded to whole rows.")
@click.option("--offset-um", type=NUMBER, default=29.0, show_default=True, help="Slit offset.")
@state_option
@seed_option
@imperfect_option
@output_option
@force_option
def axial(output: Path, force: bool, **options: Any) -> None:
    """Simulate a scan of depths of a stained plate: raw frames, NAME.{depths.csv,calibration.json,truth.json}."""
    from napari_elsplus.workflows.simulated import simulate_axial_scan

    _refuse(output, force=force)
    _save(simulate_axial_scan(**options), output, force=force)


@command.command()
@preset_option
@offset_option
@slit_option
@state_option
@seed_option
@imperfect_option
@click.option("-o", "--output", type=FILE, required=True, help="Folder to write into.")
@force_option
def calibration(output: Path, force: bool, **options: Any) -> None:
    """Simulate the recordings of a calibration: line, sweep, transmission, background; and the truth, into a folder."""
    from napari_elsplus.workflows.simulated import simulate_calibration

    simulate_calibration(**options).save(output, force=force, progress=progress)
    click.echo(f"wrote {output}")


def _refuse(output: Path, *, force: bool, inputs: Sequence[Path] = ()) -> None:
    from napari_elsplus.io.formats.registry import format_to_write

    refuse_outputs(output, force=force, inputs=inputs)
    format_to_write(output)


def _save(simulated: SimulatedRecording, output: Path, *, force: bool) -> None:
    simulated.save(output, force=force, progress=progress)
    click.echo(f"wrote {len(simulated)} frames to {output}")
