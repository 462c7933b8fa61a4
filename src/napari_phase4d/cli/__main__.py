"""Lets ``python -m napari_phase4d.cli`` be the command line."""

from napari_phase4d.cli import main

if __name__ == "__main__":
    main()
