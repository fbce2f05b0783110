"""Files: recordings, calibrations, tracks, all written beside and renamed.

``open_recording`` -> :class:`Recording`, whatever the format; ``RecordingWriter`` while the camera runs;
``write_stack`` and ``write_mosaic`` for finished images; calibrations, tracks and one-column CSV files by ``read_*``
and ``write_*``.
"""

from napari_elsplus.io.atomic import refuse_existing, replacing, replacing_all
from napari_elsplus.io.calibrations import beside, calibration_beside, read_calibration, write_calibration
from napari_elsplus.io.columns import read_depths_um, read_volts, write_column, write_table
from napari_elsplus.io.formats.ome_tiff import write_mosaic, write_stack
from napari_elsplus.io.recorder import RecordingWriter
from napari_elsplus.io.recordings import Recording, open_recording
from napari_elsplus.io.track_table import TrackTable
from napari_elsplus.io.tracks import TrackPoint, read_track, write_track

__all__ = [
    "Recording",
    "RecordingWriter",
    "TrackPoint",
    "TrackTable",
    "beside",
    "calibration_beside",
    "open_recording",
    "read_calibration",
    "read_depths_um",
    "read_track",
    "read_volts",
    "refuse_existing",
    "replacing",
    "replacing_all",
    "write_calibration",
    "write_column",
    "write_mosaic",
    "write_stack",
    "write_table",
    "write_track",
]
