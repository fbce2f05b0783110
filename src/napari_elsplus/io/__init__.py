"""Files: recordings, calibrations, tracks and tables; every output is written beside its target, then renamed.

:func:`open_recording` returns a :class:`Recording` of any registered format; :class:`RecordingWriter` writes one while
the camera runs; :func:`write_images` and :func:`write_mosaic` write finished images by their file's suffix.
Names are imported when they are first used, so that `io.settings` and `io.user_folders` load neither numpy nor a
decoder.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
