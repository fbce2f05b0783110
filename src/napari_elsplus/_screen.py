"""Whether a window can be opened here: ``python -m napari_elsplus._screen``.

A program of its own, because Qt ends the process that it cannot serve. Exits 0 and prints what draws; else exits with
another code and says why on standard error.
"""

from __future__ import annotations

import os
import sys

INVISIBLE_PLATFORMS = ("offscreen", "minimal", "minimalegl")


def main() -> int:
    """Ask Qt for a screen and for OpenGL on it."""
    asked_for = os.environ.get("QT_QPA_PLATFORM", "")
    names_a_display = asked_for or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not names_a_display:
        return _no("neither DISPLAY nor WAYLAND_DISPLAY is set")
    try:
        from qtpy.QtGui import QGuiApplication, QOffscreenSurface, QOpenGLContext
    except ImportError as error:
        return _no(str(error).strip().splitlines()[0])
    application = QGuiApplication([])
    platform = application.platformName()
    if platform in INVISIBLE_PLATFORMS:
        return _no(f"Qt draws on {platform!r}, which nobody sees")
    surface, context = QOffscreenSurface(), QOpenGLContext()
    surface.create()
    if not (context.create() and context.makeCurrent(surface)):
        return _no(f"the screen ({platform}) offers no OpenGL")
    from OpenGL import GL

    renderer, version = (GL.glGetString(name) for name in (GL.GL_RENDERER, GL.GL_VERSION))
    context.doneCurrent()
    sys.stdout.write(f"{platform}, OpenGL {version.decode()} on {renderer.decode()}\n")
    return 0


def _no(why: str) -> int:
    sys.stderr.write(f"{why}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
