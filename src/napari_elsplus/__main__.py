"""The command line by ``python -m napari_elsplus``, wherever the folder of programs is not on the path."""

from napari_elsplus.cli import main

if __name__ == "__main__":
    main()
