"""Files: recordings, calibrations, tracks and tables; every output is written beside its target, then renamed.

:func:`open_recording` returns a :class:`Recording` of any registered format; :class:`RecordingWriter` writes one while
the camera runs; :func:`write_images` and :func:`write_mosaic` write finished images by their file's suffix,
:func:`write_stack` an OME-TIFF. Names are imported when they are first used, so that `io.settings` and
`io.user_folders` load neither numpy nor a decoder.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from napari_elsplus.io.atomic import refuse_existing, replacing, replacing_all
    from napari_elsplus.io.calibration_lookup import beside, calibration_beside, existing_beside
    from napari_elsplus.io.calibrations import read_calibration, write_calibration
    from napari_elsplus.io.columns import read_depths_um, read_volts, volts_beside, write_column, write_table
    from napari_elsplus.io.finished_images import write_images, write_mosaic
    from napari_elsplus.io.formats.ome_tiff import write_stack
    from napari_elsplus.io.formats.registry import FileFormat, register_format
    from napari_elsplus.io.formats.source import FrameSource
    from napari_elsplus.io.recorder import RecordingWriter
    from napari_elsplus.io.recordings import Recording, open_recording
    from napari_elsplus.io.track_table import TrackTable
    from napari_elsplus.io.tracks import TrackPoint, read_track, write_track

_MODULES = {
    "atomic": ("refuse_existing", "replacing", "replacing_all"),
    "calibration_lookup": ("beside", "calibration_beside", "existing_beside"),
    "calibrations": ("read_calibration", "write_calibration"),
    "columns": ("read_depths_um", "read_volts", "volts_beside", "write_column", "write_table"),
    "finished_images": ("write_images", "write_mosaic"),
    "formats.ome_tiff": ("write_stack",),
    "formats.registry": ("FileFormat", "register_format"),
    "formats.source": ("FrameSource",),
    "recorder": ("RecordingWriter",),
    "recordings": ("Recording", "open_recording"),
    "track_table": ("TrackTable",),
    "tracks": ("TrackPoint", "read_track", "write_track"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "FileFormat",
    "FrameSource",
    "Recording",
    "RecordingWriter",
    "TrackPoint",
    "TrackTable",
    "beside",
    "calibration_beside",
    "existing_beside",
    "open_recording",
    "read_calibration",
    "read_depths_um",
    "read_track",
    "read_volts",
    "refuse_existing",
    "register_format",
    "replacing",
    "replacing_all",
    "volts_beside",
    "write_calibration",
    "write_column",
    "write_images",
    "write_mosaic",
    "write_stack",
    "write_table",
    "write_track",
]

if not TYPE_CHECKING:  # else every misspelt name would pass as Any

    def __getattr__(name: str) -> object:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value
