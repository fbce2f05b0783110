"""From raw frames to the mosaic: each stage, all of them on one thread and on two.

Run with asv, or compare with the paper and its peers by hand: ``python3 run.py bench live --out DIR``.
"""

from __future__ import annotations

import numpy as np

from benchmarks.rigs.simulated import simulated_rig
from benchmarks.studies.stages import STAGES, our_stages
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Straight
from napari_elsplus.workflows.tracking import Pipeline
from napari_elsplus.workflows.two_threads import tracking_images

FRAMES = 48
PATHS = {"hand, 1.5 mm/s": HandHeld(1500.0), "straight, 8 mm/s": Straight(8000.0)}


class Tracking:
    """A recording of 524 x 1328 pixels at 240 Hz, tracked and laid into a mosaic."""

    params = tuple(PATHS)
    param_names = ("path",)
    timeout = 120

    def setup(self, path):
        self.rig = simulated_rig()
        self.raw = self.rig.recording(scene("fibres"), PATHS[path], FRAMES)
        self.true_px = self.rig.positions_px(PATHS[path], FRAMES)
        self.time_one_thread(path)
        self.time_two_threads(path)

    def pipeline(self):
        return Pipeline(self.rig.calibration, self.rig.instrument.frame_shape)

    def time_one_thread(self, path):
        pipeline = self.pipeline()
        for number, raw in enumerate(self.raw):
            pipeline.add(raw, number)

    def time_two_threads(self, path):
        pipeline = self.pipeline()
        images = tracking_images(pipeline, ((raw, raw) for raw in self.raw), len(self.raw))
        for number, image in enumerate(images):
            pose = pipeline.tracking.estimate_pose(image)
            pipeline.note(pose, number, np.nan)
            pipeline.insert(lambda image=image: image, pose)

    def track_pair_error_px(self, path):
        pipeline = self.pipeline()
        for number, raw in enumerate(self.raw):
            pipeline.track(raw, number)
        place = np.array([(row.row_px, row.col_px) for row in pipeline.rows])
        return float(np.median(np.hypot(*(np.diff(place, axis=0) - np.diff(self.true_px, axis=0)).T)))

    track_pair_error_px.unit = "px"


class Stages:
    """Time of each stage for each frame."""

    params = STAGES
    param_names = ("stage",)
    timeout = 120

    def setup_cache(self):
        rig = simulated_rig()
        raw = rig.recording(scene("fibres"), Straight(8000.0), FRAMES)
        our_stages(rig.calibration, raw[:8])
        return our_stages(rig.calibration, raw)

    def track_stage_us(self, stages, stage):
        return stages[stage]

    track_stage_us.unit = "us"
