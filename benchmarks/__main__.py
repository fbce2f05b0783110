"""Speed against accuracy, for every choice that the software makes: ``python3 run.py bench``, from a checkout."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.documents import calibration_accuracy, figures, mosaicing, paper, physics, recommendation, subtraction
from benchmarks.documents.ablation import ablation_table, draw_ablation
from benchmarks.documents.architecture import draw_architecture, read_rooms
from benchmarks.documents.benchmark import draw_benchmark
from benchmarks.documents.cores import draw_bundle_frames
from benchmarks.documents.finished import draw_finished
from benchmarks.documents.pages import fill
from benchmarks.documents.photographs import draw_photographs
from benchmarks.harness.methods import Chart
from benchmarks.harness.peers import PACKAGES, environment, install
from benchmarks.harness.registry import MODULES, PROGRAMS, benchmark, program
from benchmarks.harness.running import run
from benchmarks.harness.table import breakdowns, header, lines, markdown, results_in, write_csv
from benchmarks.harness.verdict import verdict
from benchmarks.imperfect import row_twins, study, survey
from benchmarks.imperfect.cases import CASES
from benchmarks.studies import ablation, line_fit
from napari_elsplus._program import run_program
from napari_elsplus.cli.options import FILE, force_option, refuse_outputs
from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.harness.methods import Result


PAGES = ("performance.md", "stability.md", "paper.md")
PAGE_PROGRAMS = (
    "calibration",
    "mosaicing",
    "recommendation",
    "physics",
    "subtraction",
    "line-fit",
    "architecture",
    "figures",
)
"""Programs of single pages; ``mosaicing-TABLE`` makes one table."""
DOCS = Path(__file__).resolve().parents[1] / "docs"
PACKAGE = DOCS.parent / "src" / "napari_elsplus"


class _Benchmarks(click.Group):
    """The commands below, one for each program, and one for each benchmark."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*super().list_commands(ctx), *PROGRAMS, *MODULES]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in PROGRAMS:
            return program(cmd_name)
        return _measuring(cmd_name) if cmd_name in MODULES else super().get_command(ctx, cmd_name)


@click.command(cls=_Benchmarks, context_settings={"help_option_names": ["-h", "--help"]})
def bench() -> None:
    """Measure cost and error of everything that the software could have chosen: table, CSV, chart."""


@bench.command(name="list")
def list_benchmarks() -> None:
    """List the benchmarks."""
    for name in MODULES:
        click.echo(f"{name:19} {benchmark(name).question}")
    click.echo(f"{'paper':19} The paper's figures on the simulated rig")
    click.echo(f"{'imperfect':19} What each imperfection of a rig costs, with and without its correction")


@bench.command()
def peers() -> None:
    """Install the peers, each into an environment of its own."""
    for name in PACKAGES:
        click.echo(f"{name} {install(name)} in {environment(name)}")


@bench.command(name="paper")
@click.option("--out", type=FILE, required=True, help="Folder for the figures.")
@click.option("--quick", is_flag=True, help="Few frames: a check that it runs.")
@force_option
def paper_figures(out: Path, quick: bool, force: bool) -> None:
    """Draw the paper's figures on the simulated rig, and print their numbers."""
    out.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("paper") as status:
        tables = paper.make(out, quick=quick, force=force, report=status.update)
    for name, table in tables.items():
        click.echo(f"{name}\n{table}\n")


@bench.command(name="imperfect")
@click.option("--out", type=FILE, required=True, help="Folder for imperfect.csv, imperfect.png and imperfect-rigs.csv.")
@click.option("--quick", is_flag=True, help="A few cases: a check that it runs.")
@click.option("--rigs", type=click.IntRange(min=0), default=0, show_default=True, help="Rigs drawn at random, too.")
@click.option("--first-seed", type=int, default=10400, show_default=True, help="Of these; smaller ones were looked at.")
@click.option("--twins", type=click.IntRange(min=0), default=0, show_default=True, help="Twins of the independent rig.")
@click.option("--only-rigs", is_flag=True, help="No cases, only the rigs and twins.")
@click.option("--resume", is_flag=True, help="Keep the rows that the CSV files have already.")
@click.option("--docs", "folder", type=FILE, help="Folder of the documentation whose tables and chart are renewed.")
@force_option
def imperfect_rigs(
    out: Path,
    quick: bool,
    rigs: int,
    first_seed: int,
    twins: int,
    only_rigs: bool,
    resume: bool,
    folder: Path | None,
    force: bool,
) -> None:
    """Disturb the simulated rig by each imperfection, with and without its correction, and draw rigs at random."""
    names = ("imperfect.csv", "imperfect-rigs.csv", "imperfect.png")
    *tables, chart = results_in(out, *names, force=force or resume)
    if not resume:
        for path in tables:
            path.unlink(missing_ok=True)
    blocks = {}
    with Console(stderr=True).status("imperfect") as status:
        if not only_rigs:
            outcomes = study.run_cases(study.quick_cases() if quick else CASES, tables[0], status.update)
            save_figure(study.draw_outcomes(outcomes), chart, force=True)
            blocks["imperfect"] = study.markdown(outcomes)
        if rigs:
            seeds = range(first_seed, first_seed + rigs)
            blocks["imperfect-rigs"] = survey.markdown(survey.survey(seeds, tables[1], status.update))
        if twins:
            seeds = range(row_twins.FIRST_SEED, row_twins.FIRST_SEED + twins)
            blocks["imperfect-twins"] = row_twins.markdown(
                row_twins.compare_twins(seed, status.update) for seed in seeds
            )
    for block in blocks.values():
        click.echo(block)
    if folder is not None:
        fill(folder / "simulation.md", blocks)
        if not only_rigs:
            save_figure(study.draw_outcomes(outcomes), folder / "images" / "bench-imperfect.png", force=True)


@bench.command(name="ablation")
@click.argument("words", nargs=-1)
@click.option("--out", type=FILE, required=True, help="Folder for ablation.md and ablation.png.")
@click.option("--quick", is_flag=True, help="One recording: a check that it runs.")
@click.option("--docs", "folder", type=FILE, help="Folder of the documentation whose table and chart are renewed.")
@force_option
def ablation_command(words: tuple[str, ...], out: Path, quick: bool, folder: Path | None, force: bool) -> None:
    """Leave out each rule of the acceptance test, halve and double each constant; WORDS choose of them."""
    table, chart = results_in(out, "ablation.md", "ablation.png", force=force)
    unchanged, *changed = ablation.changes()
    chosen = [unchanged, *(c for c in changed if not words or any(word in f"{c.rule}: {c.change}" for word in words))]
    seeds, kinds = (ablation.SEEDS[:1], ablation.KINDS[:1]) if quick else (ablation.SEEDS, ablation.KINDS)
    found = []
    with Console(stderr=True).status("ablation") as status:
        for one in ablation.ablate(chosen, seeds, kinds, status.update):
            found.append(one)
            table.write_text(f"{ablation_table(found)}\n", "utf-8")
            click.echo(table.read_text("utf-8").splitlines()[-1])
    save_figure(draw_ablation(found), chart, force=True)
    if folder is not None:
        fill(folder / mosaicing.PAGE, {"ablation": ablation_table(found)})
        save_figure(draw_ablation(found), folder / "images" / "mosaicing-ablation.png", force=True)


@bench.command()
@click.argument("stack", type=FILE)
@click.option("--out", type=FILE, required=True, help="The picture, .png or .svg.")
@force_option
def finished(stack: Path, out: Path, force: bool) -> None:
    """Draw the mosaic of a stack of finished images, and its track."""
    refuse_outputs(out, force=force)
    with open_recording(stack) as frames:
        save_figure(draw_finished(frames), out, force=force)


@bench.command(name="bundle-frames")
@click.argument("flat", type=FILE)
@click.option("--out", type=FILE, required=True, help="The picture, .png or .svg.")
@force_option
def bundle_frames_command(flat: Path, out: Path, force: bool) -> None:
    """Make frames of a photographed, evenly lit bundle over moving bars, and draw them finer than its cores."""
    refuse_outputs(out, force=force)
    with open_recording(flat) as frames:
        figure, errors_px = draw_bundle_frames(np.asarray(frames[0], np.float32))
    save_figure(figure, out, force=force)
    for name, error_px in errors_px.items():
        click.echo(f"{name}: displacements right to {error_px:.2f} px")


@bench.command(name="photographs")
@click.argument("folder", type=FILE)
@click.option("--out", type=FILE, required=True, help="The picture, .png or .svg.")
@force_option
def photographs_command(folder: Path, out: Path, force: bool) -> None:
    """Draw PyFibreBundle's photographs of targets by each way to show one frame, side by side."""
    refuse_outputs(out, force=force)
    save_figure(draw_photographs(folder), out, force=force)


@bench.command()
@click.option("--docs", "folder", type=FILE, default=DOCS, show_default="this checkout's", help="Folder of the pages.")
@click.option("--quick", is_flag=True, help="Small cases: a check that it runs, not what the pages should say.")
@click.option("--only", multiple=True, help="A benchmark, paper, or a page's name; all by default. May be repeated.")
@click.option("--photographs", type=FILE, help="Folder of real ones: calibration makes only their table.")
def docs(folder: Path, quick: bool, only: tuple[str, ...], photographs: Path | None) -> None:
    """Measure everything and put charts and tables into the documentation's pages."""
    names = (*MODULES, "paper", *PAGE_PROGRAMS)
    for name in only:
        if name not in names and name.removeprefix("mosaicing-") not in mosaicing.TABLES:
            raise InputError(f"nothing in the documentation is called {name!r}", f"choose of {', '.join(names)}")
    images = folder / "images"
    images.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("docs") as status:
        for name in only or names:
            status.update(name)
            if name in MODULES or name == "paper":
                blocks = _blocks(name, images, quick, status.update)
                put = [block for page in PAGES for block in fill(folder / page, blocks)]
                click.echo(f"{name}: {', '.join(put) or 'in no page'}")
            else:
                click.echo(f"{name}: {_page(name, folder, quick, photographs)}")


def _blocks(name: str, images: Path, quick: bool, report: Callable[[str], None]) -> dict[str, str]:
    """Run a benchmark, or the paper's figures; draw its chart, and return its tables by their marks."""
    if name == "paper":
        return paper.make(images, quick=quick, force=True, report=report)
    result = run(benchmark(name), quick=quick, report=report)
    save_figure(draw_benchmark(result), images / f"bench-{name}.png", force=True)
    failures = result.benchmark.chart is Chart.FAILURES
    return {name: breakdowns(result) if failures else markdown(result), "machine": result.machine}


def _page(name: str, folder: Path, quick: bool, photographs: Path | None) -> str:
    """Make what a page shows beside the benchmarks, and return where it went."""
    match name:
        case "architecture":
            save_figure(draw_architecture(read_rooms(PACKAGE)), folder / "images" / "architecture.png", force=True)
            return "images/architecture.png"
        case "figures":
            figures.make(folder / "images", quick=quick)
            return "images/figure-comparison.png, images/calibration-report.pdf"
        case "line-fit":  # numbers of the model line, written by hand into physics.md and instrument presets
            return line_fit.report(quick=quick)
        case "calibration":
            calibration_accuracy.make(folder, photographs, quick=quick)
        case "recommendation":
            recommendation.make(folder, quick=quick)
            return "calibration.md"
        case "physics":
            physics.make(folder, quick=quick)
        case "subtraction":
            subtraction.make(folder, quick=quick)
            return "physics.md"
        case _:
            mosaicing.make(folder, tuple(name.split("-")[1:]), quick=quick)
    return f"{name.partition('-')[0]}.md"


def _measuring(name: str) -> click.Command:
    def measure(out: Path, quick: bool, force: bool) -> None:
        table, chart = results_in(out, f"{name}.csv", f"{name}.png", force=force)
        console = Console(stderr=True)
        with console.status(name) as status:
            result = run(benchmark(name), quick=quick, report=status.update)
        write_csv(result, table, force=force)
        save_figure(draw_benchmark(result), chart, force=force)
        _show(result)

    question = benchmark(name).question
    options = [
        click.Option(["--out"], type=FILE, required=True, help="Folder for NAME.csv and NAME.png."),
        click.Option(["--quick"], is_flag=True, help="Small cases, a single round: a check that it runs."),
        click.Option(["--force"], is_flag=True, help="Overwrite existing output files."),
    ]
    return click.Command(name, callback=measure, params=list(options), help=f"{question}.", short_help=question)


def _show(result: Result) -> None:
    console = Console(width=None if Console().is_terminal else 180)
    table = Table(title=result.benchmark.question, caption=result.machine)
    for title in header(result):
        table.add_column(title)
    for line in lines(result):
        table.add_row(*line)
    console.print(table)
    if result.benchmark.chart in (Chart.PARETO, Chart.STAGES):
        for case in result.cases:
            click.echo(f"{case}: {verdict(result, case)}")
    for name, why in result.absent.items():
        click.echo(f"absent: {name}: {why}")


if __name__ == "__main__":
    run_program(bench, "run.py bench")
