"""The engine's process with the small rig of these tests; run by path. It notes in a file where the mirror stands.

A file of that name ending in .fault makes it fail in the way that is written there.
Arguments: the file, and the address of a virtual card if the mirror shall be driven by that.
"""

from __future__ import annotations

import errno
import runpy
import sys
from contextlib import ExitStack
from pathlib import Path

from napari_elsplus.acquisition.link.server import run
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.guardian.supervision import guard_scanner
from napari_elsplus.hardware.takeover import ParkOrder
from napari_elsplus.io import RecordingWriter

small = runpy.run_path(str(Path(__file__).parents[1] / "small_rig.py"))  # which imports no pytest


def open_rig(name: str) -> object:
    if name not in ("small", "simulated"):
        raise small["DeviceError"](f"there is no rig {name!r}", "choose small")
    rig = small["SmallRig"]()
    if len(sys.argv) > 2:
        card = CardSettings(small["PARK_V"], address=sys.argv[2])
        rig.scanner = DaqScanner(card, rig.limits)
        held = ExitStack()
        rig.guardian = guard_scanner(rig.scanner, ParkOrder(card, rig.limits), held)
        close, rig.close = rig.close, lambda: (held.close(), close())
        return rig

    def note(what: str) -> None:
        with Path(sys.argv[1]).open("a") as file:
            file.write(what + "\n")

    fault = Path(sys.argv[1]).with_suffix(".fault")
    read, append = rig.camera.read_into, RecordingWriter.append

    def read_or_fail(buffer: object, timeout_s: float) -> object:
        if fault.exists() and fault.read_text() == "unplugged":
            raise small["DeviceError"]("the camera was unplugged", "plug it in and connect again")
        return read(buffer, timeout_s)

    def append_or_fail(writer: RecordingWriter, *arguments: object) -> None:
        if fault.exists() and fault.read_text() == "No space left":
            raise OSError(errno.ENOSPC, "No space left on device", str(writer.path))
        append(writer, *arguments)

    rig.camera.read_into, RecordingWriter.append = read_or_fail, append_or_fail
    park, scan = rig.scanner.park, rig.scanner.scan
    rig.scanner.park = lambda: (park(), note("park"))
    rig.scanner.scan = lambda waveform: (scan(waveform), note("scan"))
    return rig


if __name__ == "__main__":
    run(open_rig)  # type: ignore[arg-type]
