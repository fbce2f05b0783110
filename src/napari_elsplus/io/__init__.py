"""Files: recordings, calibrations, tracks and tables; every output is written beside its target, then renamed.

:func:`open_recording` returns a :class:`Recording` of any registered format; :class:`RecordingWriter` writes one while
the camera runs; :func:`write_images` and :func:`write_mosaic` write finished images by their file's suffix.
Names are imported when they are first used, so that `io.settings` and `io.user_folders` load neither numpy nor a
decoder.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from napari_elsplus.io.atomic import put_in_place as put_in_place
    from napari_elsplus.io.atomic import refuse_existing as refuse_existing
    from napari_elsplus.io.atomic import refuse_suffix as refuse_suffix
    from napari_elsplus.io.atomic import replacing as replacing
    from napari_elsplus.io.atomic import replacing_all as replacing_all
    from napari_elsplus.io.calibration_lookup import beside as beside
    from napari_elsplus.io.calibration_lookup import calibration_beside as calibration_beside
    from napari_elsplus.io.calibration_lookup import existing_beside as existing_beside
    from napari_elsplus.io.calibrations import read_calibration as read_calibration
    from napari_elsplus.io.calibrations import write_calibration as write_calibration
    from napari_elsplus.io.finished_images import allocate_images as allocate_images
    from napari_elsplus.io.finished_images import fill_images as fill_images
    from napari_elsplus.io.finished_images import write_images as write_images
    from napari_elsplus.io.finished_images import write_mosaic as write_mosaic
    from napari_elsplus.io.formats.registry import FileFormat as FileFormat
    from napari_elsplus.io.formats.registry import ImageMetadata as ImageMetadata
    from napari_elsplus.io.formats.registry import register_format as register_format
    from napari_elsplus.io.formats.source import FrameSource as FrameSource
    from napari_elsplus.io.recorder import RecordingWriter as RecordingWriter
    from napari_elsplus.io.recordings import Recording as Recording
    from napari_elsplus.io.recordings import open_recording as open_recording
    from napari_elsplus.io.tables.columns import read_depths_um as read_depths_um
    from napari_elsplus.io.tables.columns import read_volts as read_volts
    from napari_elsplus.io.tables.columns import volts_beside as volts_beside
    from napari_elsplus.io.tables.columns import write_column as write_column
    from napari_elsplus.io.tables.columns import write_table as write_table
    from napari_elsplus.io.tables.track_table import TrackTable as TrackTable
    from napari_elsplus.io.tables.tracks import TrackPoint as TrackPoint
    from napari_elsplus.io.tables.tracks import read_track as read_track
    from napari_elsplus.io.tables.tracks import write_track as write_track
    from napari_elsplus.io.text import write_json as write_json

_MODULES = {
    "atomic": ("put_in_place", "refuse_existing", "refuse_suffix", "replacing", "replacing_all"),
    "calibration_lookup": ("beside", "calibration_beside", "existing_beside"),
    "calibrations": ("read_calibration", "write_calibration"),
    "finished_images": ("allocate_images", "fill_images", "write_images", "write_mosaic"),
    "formats.registry": ("FileFormat", "ImageMetadata", "register_format"),
    "formats.source": ("FrameSource",),
    "recorder": ("RecordingWriter",),
    "recordings": ("Recording", "open_recording"),
    "tables.columns": ("read_depths_um", "read_volts", "volts_beside", "write_column", "write_table"),
    "tables.track_table": ("TrackTable",),
    "tables.tracks": ("TrackPoint", "read_track", "write_track"),
    "text": ("write_json",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = list(_MODULE_OF)

if not TYPE_CHECKING:  # else every misspelt name would pass as Any

    def __getattr__(name: str) -> object:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value
