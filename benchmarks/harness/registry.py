"""Every benchmark and program by name; its module is loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    import click

    from benchmarks.harness.methods import Benchmark

MODULES: dict[str, str] = {  # the module, and its benchmark where that is not called BENCHMARK
    "registration": "choices.registration",
    "line": "choices.line",
    "cores": "choices.cores",
    "sectioning": "choices.sectioning",
    "taps": "choices.taps",
    "frontend": "choices.frontend",
    "tracking": "choices.tracking",
    "insertion": "choices.insertion",
    "enhancement": "choices.enhancement",
    "live": "choices.live",
    "engine": "choices.engine",
    "display": "choices.display",
    "recording": "choices.recording",
    "motion": "parsimony.motion",
    "parsimony-line": "parsimony.line",
    "parsimony-galvo": "parsimony.calibration:GALVO",
    "parsimony-pair": "parsimony.calibration:PAIR",
    "parsimony-axial": "parsimony.axial",
    "stability": "stability.registration",
    "pair": "choices.pair",
    "stability-line": "stability.line",
    "stability-pair": "stability.pair",
    "stability-pairs": "stability.pairs",
    "stability-tracking": "stability.tracking",
}

PROGRAMS = (
    "acquire", "batch", "driver", "live-mosaic", "long-track", "lost-probe", "mosaic-size", "mutations", "opening",
    "process", "rendering", "soak", "start",
)  # fmt: skip
"""Modules in the folder of programs, each with a command of its name."""


def program(name: str) -> click.Command:
    """Return the command of a program."""
    attribute = name.replace("-", "_")
    found: click.Command = getattr(import_module(f"benchmarks.programs.{attribute}"), attribute)
    return found


def benchmark(name: str) -> Benchmark:
    """Return the benchmark of that name.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> benchmark("cores").question
    'How to be rid of the core pattern'
    """
    if name not in MODULES:
        raise InputError(f"there is no benchmark {name!r}", f"choose one of {', '.join(MODULES)}")
    module, _, attribute = MODULES[name].partition(":")
    found: Benchmark = getattr(import_module(f"benchmarks.{module}"), attribute or "BENCHMARK")
    return found
