"""The command line: napari-phase4d demo | info | look | run | compare | reproduce | benchmark | watch."""

from napari_phase4d.cli.app import app, main

__all__ = ["app", "main"]
