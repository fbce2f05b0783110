"""Speed against accuracy, for every choice that the software makes: ``python3 run.py bench``, from a checkout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.table import Table

from benchmarks.documents import paper
from benchmarks.documents.benchmark import draw_benchmark
from benchmarks.documents.pages import fill
from benchmarks.harness.methods import Chart
from benchmarks.harness.peers import PACKAGES, environment, install
from benchmarks.harness.registry import MODULES, benchmark
from benchmarks.harness.running import run
from benchmarks.harness.table import breakdowns, header, lines, markdown, write_csv
from benchmarks.harness.verdict import verdict
from napari_elsplus.cli import run_program
from napari_elsplus.cli.options import FILE, force_option, refuse_outputs
from napari_elsplus.workflows.pictures.files import save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from benchmarks.harness.methods import Result


PAGES = ("performance.md", "stability.md", "paper.md")


class _Benchmarks(click.Group):
    """``list``, ``peers``, ``docs``, ``paper``, and a command for each benchmark."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*super().list_commands(ctx), *MODULES]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return super().get_command(ctx, cmd_name) or (_measuring(cmd_name) if cmd_name in MODULES else None)


@click.command(cls=_Benchmarks, context_settings={"help_option_names": ["-h", "--help"]})
def bench() -> None:
    """Measure cost and error of everything that the software could have chosen: table, CSV, chart."""


@bench.command(name="list")
def list_benchmarks() -> None:
    """List the benchmarks."""
    for name in MODULES:
        click.echo(f"{name:19} {benchmark(name).question}")
    click.echo(f"{'paper':19} The paper's figures on the simulated rig")


@bench.command()
def peers() -> None:
    """Install the peers, each into an environment of its own."""
    for name in PACKAGES:
        click.echo(f"{name} {install(name)} in {environment(name)}")


@bench.command(name="paper")
@click.option("--out", type=FILE, required=True, help="Folder for the figures.")
@click.option("--quick", is_flag=True, help="Few frames: whether it runs.")
@force_option
def paper_figures(out: Path, quick: bool, force: bool) -> None:
    """Draw the paper's figures on the simulated rig, and print their numbers."""
    out.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("paper") as status:
        tables = paper.make(out, quick=quick, force=force, tell=status.update)
    for name, table in tables.items():
        click.echo(f"{name}\n{table}\n")


@bench.command()
@click.option("--docs", "folder", type=FILE, required=True, help="Folder of performance.md, stability.md, paper.md.")
@click.option("--quick", is_flag=True, help="Small cases: whether it runs, not what the pages should say.")
@click.option("--only", multiple=True, help="A benchmark, or paper; all by default. May be given more than once.")
def docs(folder: Path, quick: bool, only: tuple[str, ...]) -> None:
    """Measure everything and put charts and tables into the documentation's pages."""
    images = folder / "images"
    images.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("docs") as status:
        for name in only or (*MODULES, "paper"):
            if name == "paper":
                blocks = paper.make(images, quick=quick, force=True, tell=status.update)
            else:
                result = run(benchmark(name), quick=quick, tell=status.update)
                save_figure(draw_benchmark(result), images / f"bench-{name}.png", force=True)
                failures = result.benchmark.chart is Chart.FAILURES
                blocks = {name: breakdowns(result) if failures else markdown(result), "machine": result.machine}
            put = [block for page in PAGES for block in fill(folder / page, blocks)]
            click.echo(f"{name}: {', '.join(put) or 'in no page'}")


def _measuring(name: str) -> click.Command:
    def measure(out: Path, quick: bool, force: bool) -> None:
        out.mkdir(parents=True, exist_ok=True)
        refuse_outputs(out / f"{name}.csv", out / f"{name}.png", force=force)
        console = Console(stderr=True)
        with console.status(name) as status:
            result = run(benchmark(name), quick=quick, tell=status.update)
        write_csv(result, out / f"{name}.csv", force=force)
        save_figure(draw_benchmark(result), out / f"{name}.png", force=force)
        _show(result)

    question = benchmark(name).question
    options = [
        click.Option(["--out"], type=FILE, required=True, help="Folder for NAME.csv and NAME.png."),
        click.Option(["--quick"], is_flag=True, help="Small cases, a single round: whether it runs, not how fast."),
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
