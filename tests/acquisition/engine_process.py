"""The engine's process with the small rig of these tests; run by path. It notes where the mirror stands in a file."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from napari_elsplus.acquisition.process import run

small = runpy.run_path(str(Path(__file__).with_name("conftest.py")))


def open_rig(name: str) -> object:
    if name != "small":
        raise small["DeviceError"](f"there is no rig {name!r}", "choose small")
    rig = small["SmallRig"]()

    def note(what: str) -> None:
        with Path(sys.argv[1]).open("a") as file:
            file.write(what + "\n")

    park, scan = rig.scanner.park, rig.scanner.scan
    rig.scanner.park = lambda: (park(), note("park"))
    rig.scanner.scan = lambda waveform: (scan(waveform), note("scan"))
    return rig


if __name__ == "__main__":
    run(open_rig)  # type: ignore[arg-type]
