"""``doctor``: report of installed software, devices and problems, with the command that solves each."""

from __future__ import annotations

from collections import Counter

import click


@click.command()
def command() -> None:
    """Report installed software, devices and problems, with the command that solves each problem.

    Exits 0 when the software can be used, 1 when it cannot.
    """
    from napari_elsplus.diagnosis import diagnose
    from napari_elsplus.diagnosis.finding import Level

    colours = {Level.OK: "green", Level.WARNING: "yellow", Level.PROBLEM: "red"}
    found: Counter[Level] = Counter()
    for finding in diagnose():
        level, _, rest = str(finding).partition(" ")
        click.echo(click.style(level, fg=colours[finding.level]) + " " + rest)
        found[finding.level] += 1
    usable = not found[Level.PROBLEM]
    counts = ", ".join(
        f"{count} {level}{'s' if count > 1 else ''}" for level, count in found.items() if level != Level.OK
    )
    click.echo(f"{'ready for use' if usable else 'not fit for use'} ({counts or 'no problem found'})")
    if not usable:
        raise SystemExit(1)
