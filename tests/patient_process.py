"""``napari-elsplus``, or the engine's process where no command is given, patient with a busy computer; run by path."""

from __future__ import annotations

import sys
from functools import partial

from patience import be_patient

if __name__ == "__main__":
    be_patient()
    if len(sys.argv) > 1:
        from napari_elsplus.cli import main

        main()
    else:
        from napari_elsplus.acquisition.calibrating.simulated import open_live
        from napari_elsplus.acquisition.link.server import run

        run(partial(open_live, own_process=True))
