"""File formats of recordings and images, a module for each; importing the package registers them.

Decoders (tifffile, zarr, ffmpeg) are imported when a file of theirs is opened or written.
"""

from napari_elsplus.io.formats import avi, npy, ome_zarr, tiff, tiff_folder
from napari_elsplus.io.formats.registry import register_format

for built_in in (tiff.TIFF, avi.AVI, npy.NPY, ome_zarr.OME_ZARR, tiff_folder.TIFF_FOLDER):
    register_format(built_in)
