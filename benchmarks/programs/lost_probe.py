"""Processor time of tracking a probe that jumps or has left the tissue: ``python3 run.py bench lost-probe``.

With another checkout's ``src`` in PYTHONPATH the same frames are tracked by that one.
"""

from __future__ import annotations

import time
from collections import Counter

import click
import numpy as np

from benchmarks.rigs.simulated import StopAndGo, simulated_rig, tissue
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.registration.pair_registration import Registrar
from napari_elsplus.processing.tracking.tracker import Tracker
from napari_elsplus.simulation.specimen.trajectories import Straight

PIECE = 24
"""Frames of each piece; chosen: a tenth of a second."""
PASSES = 5


@click.command()
@click.option("--scene", "name", default="fibres", show_default=True, help="Tissue that the probe jumps over.")
@click.option("--seed", default=0, show_default=True, help="Seed of the tissue and of the places.")
def lost_probe(name: str, seed: int) -> None:
    """Track a moving probe that jumps with every frame, moves on, and is lifted, three times; print times by piece."""
    rig = simulated_rig()
    random = np.random.default_rng(seed)
    places = StopAndGo(random.uniform(-4000, 4000, (PIECE, 2)), rig.instrument.optics.frame_period_s)
    steady, looked_at = Straight(5000.0), tissue(name, seed)
    moving = rig.recording(looked_at, steady, 2 * PIECE, seed=seed)
    pieces = [
        ("moving", moving[:PIECE]),
        ("jumping", rig.recording(looked_at, places, PIECE, seed=seed)),
        ("moving", moving[PIECE:]),
        ("lifted", rig.recording(tissue("smooth", seed), steady, PIECE, seed=seed)),
    ]
    frames = [(piece, frame) for piece, those in pieces * 3 for frame in those]
    taken_ms, states = [], Counter[tuple[str, str]]()
    for turn in range(PASSES + 1):  # the first compiles
        front_end = FrontEnd(rig.calibration, rig.instrument.frame_shape)
        tracker = Tracker(Registrar(front_end.grid))
        taken_ms.append(np.zeros(len(frames)))
        for number, (piece, frame) in enumerate(frames):
            front_end.image(frame, tracker.slot())
            begun_s = time.thread_time()
            pose = tracker.add()
            taken_ms[-1][number] = 1e3 * (time.thread_time() - begun_s)
            if turn == PASSES:
                states[piece, pose.state.value] += 1
    median_ms = np.median(taken_ms[1:], axis=0)
    for piece in ("moving", "jumping", "lifted"):
        those = median_ms[[piece == other for other, _ in frames]]
        counts = ", ".join(f"{count} {state}" for (other, state), count in states.items() if other == piece)
        click.echo(f"{piece:8} {those.mean():5.2f} ms mean, {those.max():5.2f} ms at most; {counts}")
